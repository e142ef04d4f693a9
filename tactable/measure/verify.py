"""A table's promise compared with what a sensor reads: steady drives and clicks of random placements, point by point.

The untouched bar is compared, with the sensor's mass on it: fingers would load it by an amount that nobody knows. What
is played is what a run would play for the placements. The promise at a point is an interval, the range over bars that
the table holds for possible: those that its calibration leaves, or those within `[spread]`, each with the sensor up to
about a millimetre beside its place. A reading adds its own error. A bar that the table describes leaves the interval at
few points; more than MOST_OUTSIDE of them say that the bar, the sensor or the table is another.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.device import Device, Finger
from engine.effects import Drives
from engine.steady import SteadyDrive
from engine.table import ClickEntry, Table
from engine.table.best_rows import BestRow
from engine.touch import Placement, ZoneState
from firmware_link.protocol.basis import SAMPLE_FULL_SCALE, encode_click
from precompute.model.assembly import Plant, assemble
from precompute.model.modal import compute_basis
from precompute.model.response import solve_response
from precompute.model.transient import TransientPlant
from precompute.sampling.plants import sample_scenarios
from tactable.measure.apparatus import Apparatus
from tactable.measure.asked_drive import AskedDrive
from tactable.measure.driven_device import DrivenDevice
from tactable.measure.faults import SPOILING, Fault
from tactable.measure.stepped_sine import SteppedSine, SteppedSineOptions, slowest_decay_per_s

Array = NDArray[np.float64]

BARS = 40
MOST_OUTSIDE = 0.1
"""Share of the points that may lie outside: the range over 40 bars leaves 5 % of them outside by chance."""
MOST_SPOILED = 0.1
"""Share of the points that may be spoiled; where more are, the promise counts as not tested."""
PLACE_M = 0.5e-3
"""Standard deviation of the place of the sensor."""
LEAST_M_PER_S2 = 0.02
"""What a point is off at the least, by the noise of a sensor."""
RING_S = 0.1
_SEED = 20230247606
_RATE_HZ = 24_000.0


@dataclass(frozen=True)
class Played:
    """The two kinds of output that are played at every place: a steady drive, and a click of the table."""

    placement: Placement
    asked: AskedDrive | None
    click: ClickEntry | None

    @property
    def kind(self) -> str:
        """The word drive or click."""
        return "drive" if self.click is None else "click"


@dataclass(frozen=True)
class Point:
    """One reading against its promise: peaks in m/s^2; low to high is the promised interval."""

    played: Played
    position_m: float
    read_m_per_s2: float
    promised_m_per_s2: float
    low_m_per_s2: float
    high_m_per_s2: float
    faults: tuple[Fault, ...]

    @property
    def is_spoiled(self) -> bool:
        """Whether a fault makes the reading wrong: it is not compared."""
        return any(fault in SPOILING for fault in self.faults)

    @property
    def is_outside(self) -> bool:
        """Whether the reading is beyond the promised interval."""
        return not self.is_spoiled and not self.low_m_per_s2 <= self.read_m_per_s2 <= self.high_m_per_s2


def plan_played(
    table: Table, placements: Sequence[Placement], level_db: float, drives: Drives = Drives.POSITIONS
) -> tuple[Played, ...]:
    """The steady drive of each placement at a level, and its click where the table has one.

    In zones it is the row of the sweep, and there are no clicks. Raises TableError for zones without a row.
    """
    found = []
    for placement in placements:
        drive = _drive_of(table, placement, level_db, drives)
        asked = AskedDrive(drive.frequencies_hz, drive.amplitudes, drive.phases_rad)
        found.append(Played(placement, asked, None))
        has_clicks = bool(table.clicks) and drives is Drives.POSITIONS
        click = table.click_at(placement, level_db) if has_clicks else None
        if click is not None:
            found.append(Played(placement, None, click))
    return tuple(found)


def _drive_of(table: Table, placement: Placement, level_db: float, drives: Drives) -> SteadyDrive | BestRow:
    if drives is Drives.ZONES:
        states = zip(table.device.zones, placement.zone_states(table.device), strict=True)
        return table.best_row([zone.name for zone, state in states if state is ZoneState.FELT], level_db)
    felt, quiet = ([placement.position_m[i] for i in which] for which in (placement.felt, placement.quiet))
    return table.drive_for(felt, quiet, level_db)


class PossibleBars:
    """Bars that a table holds for possible, the nominal one first, with a sensor of a mass at a place."""

    def __init__(self, device: Device, sensor_mass_kg: float, bars: int = BARS) -> None:
        scenarios, random = sample_scenarios(device, bars, _SEED), np.random.default_rng(_SEED)
        others = (scenarios.device_of(i) for i in range(1, len(scenarios)))
        self._plants: list[Plant] = [assemble(each) for each in (device, *others)]
        self._bases = [compute_basis(plant) for plant in self._plants]
        self._off_m = np.concatenate([[0.0], PLACE_M * random.standard_normal(len(self._plants) - 1)])
        self._sensor = Finger(mass_kg=sensor_mass_kg, damping_n_s_per_m=0.0, stiffness_n_per_m=0.0, spread=1.0)
        self._length_m = device.bar.length_m

    def peaks(self, played: Played, position_m: float) -> Array:
        """Peak (bar,) at the sensor in m/s^2."""
        places_m = np.clip(position_m + self._off_m, 0.0, self._length_m)
        return np.array([self._peak(bar, played, float(place_m)) for bar, place_m in enumerate(places_m)])

    def _peak(self, bar: int, played: Played, place_m: float) -> float:
        place = np.array([place_m])
        if played.asked is not None:
            loaded, tones = self._plants[bar].with_fingers([place_m], self._sensor), played.asked.tones
            hz = np.array([tone.frequency_hz for tone in tones])
            unit = solve_response(loaded, hz).acceleration(place)[:, :, 0]
            return float(sum(abs(tone.phasors @ each) for tone, each in zip(tones, unit, strict=True)))
        assert played.click is not None
        click = played.click
        plant = TransientPlant(self._bases[bar], place, _RATE_HZ)
        plant.touch([(place_m, self._sensor)])
        time_s = np.arange(round((click.length_s + RING_S) * _RATE_HZ)) / _RATE_HZ
        samples = click.amplitude * click.samples / SAMPLE_FULL_SCALE
        own_s = np.arange(len(samples)) / click.sample_rate_hz
        drive = np.column_stack([np.interp(time_s, own_s, column, right=0.0) for column in samples.T])
        return float(abs(plant.accelerate(drive)).max())


def verify_table(
    table: Table,
    played: Sequence[Played],
    position_m: Sequence[float],
    apparatus: Apparatus,
    options: SteppedSineOptions,
    sensor_mass_kg: float,
) -> tuple[Point, ...]:
    """Play everything at every place, and compare."""
    bars, points, decay_per_s = (
        PossibleBars(table.device, sensor_mass_kg),
        list[Point](),
        slowest_decay_per_s(table.device),
    )
    for place_m in position_m:
        apparatus.guide(place_m)
        with apparatus.open_driven() as driven:
            stepped = SteppedSine(table.device, driven, apparatus.sensor, options, decay_per_s)
            rest = stepped.listen()
            read = [(each, found) for each in played if (found := _read(stepped, driven, each)) is not None]
        # Not before the board is at rest: an armed one does not wait for so long.
        for each, (size, error, faults) in read:
            promised = bars.peaks(each, place_m)
            margin = 3 * error + max(LEAST_M_PER_S2, 4 * rest.noise * (each.click is not None))
            low, high = float(promised.min()) - margin, float(promised.max()) + margin
            points.append(Point(each, place_m, size, float(promised[0]), max(0.0, low), high, faults))
    return tuple(points)


def verdict_of(points: Sequence[Point]) -> str:
    """Whether the promise is kept, as words.

    kept; beyond: more points than chance allows; in part: kept where it was read, but too many readings are spoiled to
    say so of the rest; not compared: all are spoiled.
    """
    compared, outside = sum(not point.is_spoiled for point in points), sum(point.is_outside for point in points)
    if not compared:
        return "not compared"
    if outside > MOST_OUTSIDE * compared:
        return "beyond"
    return "in part" if len(points) - compared > MOST_SPOILED * len(points) else "kept"


def _read(stepped: SteppedSine, driven: DrivenDevice, played: Played) -> tuple[float, float, tuple[Fault, ...]] | None:
    """Peak, standard error and faults; None for a click that the board cannot play."""
    if played.asked is not None:
        # Tones of different frequencies are read one after another, and their magnitudes add, as in the promise.
        channel, held = stepped.channel, [stepped.hold(tone) for tone in played.asked.tones]
        sizes = [float(abs(fit.phasor[channel])) for fit, _, _ in held]
        error = sum(size * fit.error(channel) for size, (fit, _, _) in zip(sizes, held, strict=True))
        found = dict.fromkeys(fault for _, _, faults in held for fault in faults if fault is not Fault.NOISE)
        return sum(sizes), error, tuple(found)
    assert played.click is not None
    basis, click = driven.basis, played.click
    number, fraction_bits = basis.sets.get(click.basis_set), click.fraction_bits - basis.halvings
    if basis.basis is None or number is None or fraction_bits < 1:
        return None
    encoded = encode_click(basis.basis, number, click.weights.tolist(), fraction_bits, click.amplitude)
    acceleration, clipped = stepped.hit(encoded, click.length_s + RING_S)
    return float(abs(acceleration).max()), 0.0, (Fault.CLIPPING,) if clipped else ()
