"""A table's promise compared with what a sensor reads: steady drives and clicks of random placements, point by point.

The untouched surface is compared, with the sensor's mass on it: fingers would load it by an unknown amount. What
is played is what a run would play for the placements. The promise at a point is an interval, the range over bars that
the table holds for possible: those that its calibration leaves, or those within `[spread]`, each with the sensor up to
about a millimetre beside its place.

A reading has an error of its own: of a steady drive three standard errors, by the scatter of the sine that was fitted,
of the peak of a click what noise and hum of the bar at rest may add. So a point has one of four outcomes:

- *Broken*: the reading is beyond the interval by more than its error.
- *Kept*: it is not, and its error is at most MOST_BLUR of the greatest promised peak. So a bar that moves half as much
  again as any possible one would have been seen, and one that moves half as much as the least possible one, too, unless
  the promise itself is as wide as that.
- *Not shown*: the error is greater, so that the reading would agree with other bars as well. It keeps no promise.
- *Spoiled*: a fault makes the reading wrong.

A bar that the table describes breaks the promise at few points; more than MOST_BROKEN of those that could show it say
that the bar, the sensor or the table is another.

*The circle of a calibration*: the bar is measured before the fit, and plays the new table before that is put in place.
Each step leaves the table that a run plays as it was: the measurement writes its own file, the fit its own folder, the
build a file beside the table. Only a table that the bar was seen to keep is renamed into place. So Ctrl-C at any time
leaves the old table, a board that is silent, and what was complete; the same command goes on from there. Drives are
verified before the first change of the table, clicks before the second.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from base.arrays import Array
from base.plain import to_plain
from base.points import clip_points, parts_of
from engine.device import Device, Finger
from engine.effects.rules import Drives
from engine.steady import SteadyDrive
from engine.steady.cases import SEED
from engine.table import ClickEntry, Table
from engine.table.best_rows import BestRow
from engine.touch import Placement
from firmware_link.protocol.basis import SAMPLE_FULL_SCALE, encode_click
from precompute.measurements.measurement_file import check_ending, write_measurements
from precompute.measurements.model import even_places
from precompute.measurements.types import Kind, MeasurementError
from precompute.model.assembly import assemble
from precompute.model.modal import Basis, compute_basis
from precompute.model.plant import Plant
from precompute.model.response import solve_response
from precompute.model.transient import TransientPlant
from precompute.sampling.placements import Anywhere, random_placements
from precompute.sampling.plants import sample_scenarios
from tactable.explain.words import zone_names
from tactable.measure.apparatus import Apparatus, ApparatusOptions
from tactable.measure.board_sensor import fixed_places
from tactable.measure.driven_device import AskedDrive, DrivenDevice
from tactable.measure.faults import SPOILING, Fault
from tactable.measure.stepped_sine import Reading, SteppedSine, SteppedSineOptions, slowest_decay_per_s
from tactable.measure.walk import Method, RawFolder, Stop, measure_walk, measurements_of

BARS = 40  # see MOST_BROKEN; each is a mesh, and a plant in time for each click
MOST_BROKEN = 0.1  # share of the points that may be broken: the range over 40 bars leaves 5 % of them outside by chance
MOST_UNTESTED = 0.1  # share of the points that may be spoiled or not shown; beyond, the promise is not tested
MOST_BLUR = 0.25  # error of a reading that keeps a promise, of the greatest promised peak: 1.9 dB
PLACE_M = 0.5e-3  # standard deviation of the place of the sensor
LEAST_M_PER_S2 = 0.02  # what a point is off at the least: sensors feel a little of the other axes and of their cable
RING_S = 0.1  # the peak is in the click or just after it
_RATE_HZ = 24_000.0  # as _PLANT_HZ of simulated_bench.py


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


class Outcome(StrEnum):
    """Outcome of one reading, as the head of this module defines it."""

    KEPT = "kept"
    BROKEN = "broken"
    NOT_SHOWN = "not shown"
    SPOILED = "spoiled"


class Verdict(StrEnum):
    """Outcome of all readings together."""

    KEPT = "kept"
    BROKEN = "broken"  # more points than chance allows are broken
    IN_PART = "in part"  # kept where it was shown, but too many readings are spoiled or show nothing
    NOT_SHOWN = "not shown"  # no reading could have shown it broken


@dataclass(frozen=True)
class Point:
    """One reading against its promise: peaks in m/s^2; low to high is the promised interval, `error` the reading's."""

    played: Played
    position_m: complex
    read_m_per_s2: float
    promised_m_per_s2: float
    low_m_per_s2: float
    high_m_per_s2: float
    error_m_per_s2: float
    faults: tuple[Fault, ...]

    @property
    def outcome(self) -> Outcome:
        """Outcome of the reading."""
        if any(fault in SPOILING for fault in self.faults):
            return Outcome.SPOILED
        read, off = self.read_m_per_s2, self.error_m_per_s2 + LEAST_M_PER_S2
        if read < self.low_m_per_s2 - off or read > self.high_m_per_s2 + off:
            return Outcome.BROKEN
        is_sharp = math.isfinite(read) and self.error_m_per_s2 <= MOST_BLUR * self.high_m_per_s2
        return Outcome.KEPT if is_sharp else Outcome.NOT_SHOWN


@dataclass(frozen=True)
class Judgement:
    """How many points are kept, broken, not shown and spoiled."""

    kept: int
    broken: int
    not_shown: int
    spoiled: int

    @classmethod
    def of(cls, points: Sequence[Point]) -> "Judgement":
        """Count the outcomes of points."""
        outcomes = [point.outcome for point in points]
        return cls(*map(outcomes.count, Outcome))

    @property
    def verdict(self) -> Verdict:
        """Whether the promise is kept."""
        shown, untested = self.kept + self.broken, self.not_shown + self.spoiled
        if not shown:
            return Verdict.NOT_SHOWN
        if self.broken > MOST_BROKEN * shown:
            return Verdict.BROKEN
        return Verdict.IN_PART if untested > MOST_UNTESTED * (shown + untested) else Verdict.KEPT

    def __str__(self) -> str:
        """The counts, as a person reads them."""
        total = self.kept + self.broken + self.not_shown + self.spoiled
        return (
            f"of {total} points {self.kept} keep the promise, {self.broken} break it, {self.not_shown} are too noisy "
            f"to show it, and {self.spoiled} are spoiled"
        )


def plan_played(
    table: Table, placements: Sequence[Placement], level_db: float, drives: Drives = Drives.POSITIONS
) -> tuple[Played, ...]:
    """The steady drive of each placement at a level, and its click; where the table has none, its first felt finger's.

    In zones it is the row of the sweep, and there are no clicks. Raises TableError for zones without a row.
    """
    found = []
    for placement in placements:
        drive = _drive_of(table, placement, level_db, drives)
        asked = AskedDrive(drive.frequencies_hz, drive.amplitudes, drive.phases_rad)
        found.append(Played(placement, asked, None))
        if table.clicks and drives is Drives.POSITIONS:
            alone = Placement((placement.position_m[placement.felt[0]],), (True,))
            clicks = ((each, table.click_at(each, level_db)) for each in (placement, alone))
            found += [Played(each, None, click) for each, click in clicks if click is not None][:1]
    return tuple(found)


def _drive_of(table: Table, placement: Placement, level_db: float, drives: Drives) -> SteadyDrive | BestRow:
    if drives is Drives.ZONES:
        return table.best_row(zone_names(table.device, placement), level_db)
    felt, quiet = ([placement.position_m[i] for i in which] for which in (placement.felt, placement.quiet))
    return table.drive_for(felt, quiet, level_db)


class PossibleSurfaces:
    """Surfaces that a table holds for possible, the nominal one first, with a sensor of a mass at a place."""

    def __init__(self, device: Device, sensor_mass_kg: float) -> None:
        scenarios, random = sample_scenarios(device, BARS, SEED), np.random.default_rng(SEED)
        others = (scenarios.device_of(i) for i in range(1, len(scenarios)))
        self._plants: list[Plant] = [assemble(each) for each in (device, *others)]
        self._corner_m = device.surface.corner_m
        ways = (1.0, 1j)[: len(parts_of(self._corner_m))]
        off_m = sum(way * PLACE_M * random.standard_normal(len(self._plants) - 1) for way in ways)
        self._off_m = np.concatenate([[0.0], off_m])
        self._sensor = Finger(mass_kg=sensor_mass_kg, damping_n_s_per_m=0.0, stiffness_n_per_m=0.0, spread=1.0)

    @cached_property
    def _bases(self) -> list[Basis]:
        """Modes of each, which clicks take."""
        return [compute_basis(plant) for plant in self._plants]

    def peaks(self, played: Played, position_m: complex) -> Array:
        """Peak (surface,) at the sensor in m/s^2."""
        places_m = clip_points(position_m + self._off_m, self._corner_m)
        return np.array([self._peak(number, played, place_m) for number, place_m in enumerate(places_m.tolist())])

    def _peak(self, number: int, played: Played, place_m: complex) -> float:
        place = np.array([place_m])
        if played.asked is not None:
            loaded, tones = self._plants[number].with_fingers([place_m], self._sensor), played.asked.tones
            hz = np.array([tone.frequency_hz for tone in tones])
            unit = solve_response(loaded, hz).acceleration(place)[:, :, 0]
            return float(sum(abs(tone.phasors @ each) for tone, each in zip(tones, unit, strict=True)))
        assert played.click is not None
        click = played.click
        plant = TransientPlant(self._bases[number], place, _RATE_HZ)
        plant.touch([(place_m, self._sensor)])
        time_s = np.arange(round((click.length_s + RING_S) * _RATE_HZ)) / _RATE_HZ
        samples = click.amplitude * click.samples / SAMPLE_FULL_SCALE
        own_s = np.arange(len(samples)) / click.sample_rate_hz
        drive = np.column_stack([np.interp(time_s, own_s, column, right=0.0) for column in samples.T])
        return float(abs(plant.accelerate(drive)).max())


def verify_table(
    table: Table, played: Sequence[Played], position_m: Sequence[complex], apparatus: Apparatus, sensor_mass_kg: float
) -> tuple[Point, ...]:
    """Play everything at every place, and compare."""
    possible, decay_per_s = PossibleSurfaces(table.device, sensor_mass_kg), slowest_decay_per_s(table.device)
    points = []
    for place_m in position_m:
        apparatus.guide(place_m)
        with apparatus.open_driven() as driven:
            stepped = SteppedSine(table.device, driven, apparatus.sensor, SteppedSineOptions(), decay_per_s)
            stepped.listen()
            read = [(each, found) for each in played if (found := _read(stepped, driven, each)) is not None]
        # Not before the board is at rest: an armed one does not wait for so long.
        for each, (size, error, faults) in read:
            promised = possible.peaks(each, place_m)
            sizes = promised[0].item(), promised.min().item(), promised.max().item()
            points.append(Point(each, place_m, size, *sizes, error, faults))
    return tuple(points)


def _read(stepped: SteppedSine, driven: DrivenDevice, played: Played) -> tuple[float, float, tuple[Fault, ...]] | None:
    """Peak, its error and faults; None for a click that the board cannot play."""
    if played.asked is not None:
        # Tones of different frequencies are read one after another, and their magnitudes add, as in the promise.
        channel, held = stepped.channel, [stepped.hold(tone) for tone in played.asked.tones]
        size = sum(float(abs(fit.phasor[channel])) for fit, _, _ in held)
        error = sum(3 * fit.scatter(channel) for fit, _, _ in held)
        found = dict.fromkeys(fault for _, _, faults in held for fault in faults if fault is not Fault.NOISE)
        return size, error, tuple(found)
    assert played.click is not None
    basis, click = driven.basis, played.click
    number, fraction_bits = basis.sets.get(click.basis_set), click.fraction_bits - basis.halvings
    if basis.basis is None or number is None or fraction_bits < 1:
        return None
    encoded = encode_click(basis.basis, number, click.weights.tolist(), fraction_bits, click.amplitude)
    acceleration, faults = stepped.hit(encoded, click.length_s + RING_S)
    # Of ten thousand samples of noise one is beyond 5 standard deviations once in 200 clicks; hum has harmonics.
    return float(abs(acceleration).max()), 5 * stepped.rest.noise + 2 * stepped.rest.hum, faults


LEVEL_DB = 20.0  # DEFAULT_LEVEL_DB of engine.table.levels
PLACES, PLACEMENTS = 3, 5  # 15 points of drives and 15 of clicks: minutes; `verify` takes more
_DOUBTS = {
    Verdict.BROKEN: "the {0} does not keep what the new table promises",
    Verdict.IN_PART: "too few readings of the new table on the {0} show that it is kept",
    Verdict.NOT_SHOWN: "no reading of the new table on the {0} shows whether it is kept",
}


@dataclass(frozen=True)
class Circle:
    """An apparatus at the bar of `device`, and how the bar is measured; `options` opened the apparatus."""

    device: Device
    apparatus: Apparatus
    options: ApparatusOptions
    walk: Sequence[Stop]
    method: Method

    def measure(self, path: Path, on_reading: Callable[[Stop, Reading], None]) -> tuple[int, int]:
        """Measure the bar into a file of complex responses; one that this measurement wrote before is kept.

        Returns how many readings stayed spoiled, and are left out of the file, and how many there are. Raises
        MeasurementError where no reading is usable, where a drive is not recorded and for a file of another
        measurement, SensorError and LinkError.
        """
        check_ending(path)
        form, options = self.apparatus.sensor.form, self.options
        if any(form.loopback(actuator.name) is None for actuator in self.device.actuators):
            raise MeasurementError("an actuator has no loopback channel: add it, or take and fit peaks by `measure`")
        raw = path.with_name(f"{path.name}.raw")
        if path.exists() and not raw.is_dir():
            raise MeasurementError(f"{path}: exists and was not measured by this command; give another file")
        known = {"form": form, "method": self.method, "mass_kg": options.sensor_mass_kg, "flaws": options.flaws}
        folder = RawFolder(raw, self.device, self.walk, to_plain(known) | {"seed": options.seed})
        with threadpool_limits(1, "blas"):
            records = measure_walk(self.device, self.walk, self.apparatus, self.method, folder, on_reading)
        if not path.exists():
            how = {"is_simulated": form.is_simulated}
            found = measurements_of(records, self.device, options.sensor_mass_kg, Kind.RESPONSE, **how)
            comment = f"{'SIMULATED ' if form.is_simulated else ''}tactable calibrate --measure {self.device.name}"
            write_measurements(path, found, self.device, comment)
        readings = [reading for record in records for reading in record.readings]
        return sum(reading.is_spoiled for reading in readings), len(readings)

    def verify(self, written: Path) -> str:
        """Play a table's drives and clicks; the doubt that remains, empty for none."""
        asked = Anywhere(placements=PLACEMENTS, seed=self.options.seed + 1)
        with Table.open(written, verify=False) as table, threadpool_limits(1, "blas"):
            played = plan_played(table, random_placements(table.device, asked), LEVEL_DB)
            places_m = fixed_places(table.device, self.options.sensor, even_places(table.device, PLACES).tolist())
            points = verify_table(table, played, places_m, self.apparatus, self.options.sensor_mass_kg)
        judgement = Judgement.of(points)
        doubt = _DOUBTS.get(judgement.verdict)
        return "" if doubt is None else f"{doubt.format(self.device.surface.kind)}: {judgement}"
