"""The tables of a device description in TOML to validated parts; an error names key, value and what was expected."""

import itertools
import math
from collections.abc import Callable
from typing import Any, Self, TypeVar

import numpy as np

from base.points import point_text
from engine.device.actuator_transfer import FEWEST_POINTS, GREATEST_GROWTH, GREATEST_MISS, Transfer
from engine.device.parts import LINEARISERS, Actuator, Bar, DeviceError, Electrodes, Limits, Spread, Surface, Sweep
from engine.device.quantity import QuantityError, read_angle_rad, read_quantity
from engine.device.toml_table import TomlTable

_WIDEST_SPREAD = 0.2  # standard deviation of a stiffness or a mass: five of them are still above 0
_MOST_STEPS = 100_000  # shipped sweeps have 240; pairs grow with the square, and a slip must not ask for terabytes
_LEVELS, _MOST_LEVELS = ("10 dB", "20 dB", "30 dB"), 16
_LEAST_DISTANCE = 1e-3  # of the length: two actuators closer than that are the same one written twice
LONGEST_DELAY_S = 5e-3  # of one channel against the others: a filter, or a buffer of 240 samples at 48 kHz
PEOPLE = "people"  # in place of a fraction: fingers vary as people's do
KINDS = ("grounded", "inertial")  # of actuators: what their spring and damper stand on, the ground or a moving mass
MOST_ACTUATORS = 16  # more than any known bar has; a transfer function is fitted to points in up to 50 ms
MOST_TRANSFER_POINTS = 1000  # of all actuators: four, at each hertz from 60 to 300 Hz; one fit to all takes 0.25 s
_BEYOND_POINTS = 0.15  # part of a band's ends that points may leave out: lines of the mains lie there
_Part = TypeVar("_Part")


class DeviceTable(TomlTable):
    """A table of a device file. Every table may mark keys whose values are estimates, in its key `inferred`.

    A default that stands for a property of the device, such as its spread, is an estimate too (`assume`).
    """

    family = DeviceError

    def __init__(self, source: str, path: str, table: object) -> None:
        super().__init__(source, path, table)
        self.inferred: list[str] = []  # marked keys with their paths, of all tables of the file that were closed
        marks = self.left.pop("inferred", [])
        if not (isinstance(marks, list) and all(isinstance(mark, str) for mark in marks)):
            raise self.error("inferred", marks, "expected a list of keys of this table")
        self._marks: list[str] = marks
        self._given = frozenset(self.left)

    def section(self, key: str, read: Callable[["DeviceTable"], _Part], default: dict[str, Any] | None = None) -> _Part:
        """Read the table [key] with `read`, and close it."""
        part = DeviceTable(self.source, key, self.take_value(key, default))
        part.inferred = self.inferred
        value = read(part)
        part.close()
        return value

    def tables(self, key: str) -> list[Self]:
        """One or more [[key]] tables."""
        parts = super().tables(key)
        for part in parts:
            part.inferred = self.inferred
        return parts

    def assume(self, *keys: str) -> None:
        """Mark those of these keys as estimates that the table does not give."""
        self._marks = [*self._marks, *(key for key in keys if key not in self._given and key not in self._marks)]

    def close(self) -> None:
        """Refuse unknown keys, and keep the marked ones."""
        self.refuse_rest()
        for mark in self._marks:
            if mark not in self.known:
                raise self.error("inferred", mark, f"is no key of this table; its keys are {', '.join(self.known)}")
            self.inferred.append(".".join(part for part in (self.path, mark) if part))


def read_actuators(top: DeviceTable, surface: Surface) -> tuple[Actuator, ...]:
    """The [[actuator]] tables; no two actuators share a name or a place."""
    actuators: list[Actuator] = []
    parts = top.tables("actuator")
    if len(parts) > MOST_ACTUATORS:
        raise top.error("actuator", len(parts), f"expected at most {MOST_ACTUATORS} actuators")
    for i, part in enumerate(parts, 1):
        band_hz, stiffness_n_per_m = _read_band(part), part.quantity("stiffness", "N/m", exclusive=True)
        full_scale_m, is_force = _read_full_scale(part, stiffness_n_per_m)
        actuator = Actuator(
            name=part.name("name", f"actuator {i}"),
            position_m=part.point("position", surface.corner_m),
            stiffness_n_per_m=stiffness_n_per_m,
            damping_n_s_per_m=part.quantity("damping", "N*s/m"),
            mass_kg=part.quantity("mass", "kg"),
            full_scale_m=full_scale_m,
            band_hz=band_hz,
            transfer=_read_transfer(part, band_hz),
            electrodes=_read_electrodes(part),
            moving_mass_kg=_read_moving_mass(part),
            is_force=is_force,
            clamp_m=_read_clamp_m(part, surface),
            delay_s=_read_delay_s(part),
        )
        for other in actuators:
            if other.name == actuator.name:
                raise part.error("name", actuator.name, "another actuator has this name")
            if abs(other.position_m - actuator.position_m) < _LEAST_DISTANCE * surface.length_m:
                raise part.error("position", point_text(actuator.position_m), f"is the place of {other.name}")
        actuators.append(actuator)
        part.close()
    return tuple(actuators)


def _read_full_scale(part: DeviceTable, stiffness_n_per_m: float) -> tuple[float, bool]:
    """Displacement of the base at full scale; of a force beside the spring, as a voice coil's, force by stiffness."""
    text = part.take_value("full_scale")
    try:
        force_n = read_quantity(text, "N")
    except QuantityError:
        return part.checked("full_scale", text, "m", exclusive=True), False
    if force_n <= 0:
        raise part.error("full_scale", text, "expected more than 0 N")
    return force_n / stiffness_n_per_m, True


def _read_moving_mass(part: DeviceTable) -> float | None:
    """The moving mass of an inertial actuator, in kg; None for a grounded one."""
    if part.word("kind", KINDS, KINDS[0]) == "inertial":
        return part.quantity("moving_mass", "kg", exclusive=True)
    if part.has("moving_mass"):
        remedy = "a grounded actuator has none: leave it out, or say kind = 'inertial'"
        raise part.error("moving_mass", part.left["moving_mass"], remedy)
    return None


def _read_delay_s(part: DeviceTable) -> float:
    """What the channel is late by."""
    delay_s = part.quantity("delay", "s", default="0 s")
    if delay_s > LONGEST_DELAY_S:
        expected = f"expected up to {1e3 * LONGEST_DELAY_S:g} ms: what all channels share is no matter of the model"
        raise part.error("delay", f"{1e3 * delay_s:g} ms", expected)
    return delay_s


def _read_clamp_m(part: DeviceTable, surface: Surface) -> float:
    """Length of the stretch of bar about the actuator that does not bend."""
    clamp_m = part.quantity("clamp", "m", default="0 mm")
    if clamp_m and not isinstance(surface, Bar):
        why = "is for bars: the polynomials of a plate cannot keep a patch from bending; leave it out"
        raise part.error("clamp", f"{1e3 * clamp_m:g} mm", why)
    return clamp_m


def check_clamps(source: str, surface: Surface, actuators: tuple[Actuator, ...]) -> None:
    """Refuse clamps that reach another actuator or its clamp, or that leave nothing of the bar to bend."""
    length_m = surface.length_m
    ends_m = [(f"actuator[{i}].clamp", each, *each.clamped_m(length_m)) for i, each in enumerate(actuators, 1)]
    for key, each, start_m, stop_m in ends_m if any(each.clamp_m for each in actuators) else ():
        shown = f"{source}: {key}: {1e3 * each.clamp_m:g} mm"
        if stop_m - start_m > (1 - _LEAST_DISTANCE) * length_m:
            raise DeviceError(f"{shown}: leaves nothing of the bar to bend; give the length that the bolts hold")
        for other, own, first_m, last_m in ends_m:
            if own is not each and start_m - last_m < _LEAST_DISTANCE * length_m > first_m - stop_m:
                raise DeviceError(f"{shown}: reaches {own.name} or its clamp ({other}); give narrower clamps")


def _read_band(part: DeviceTable) -> tuple[float, float]:
    band = part.take_value("band")
    if not isinstance(band, list) or len(band) != 2:
        raise part.error("band", band, "expected two frequencies such as ['60 Hz', '300 Hz']")
    low_hz, high_hz = (part.checked("band", text, "Hz", exclusive=True) for text in band)
    if low_hz >= high_hz:
        raise part.error("band", band, "is empty: the first frequency must be below the second")
    return low_hz, high_hz


def _read_transfer(part: DeviceTable, band_hz: tuple[float, float]) -> Transfer | None:
    """The points [frequency, magnitude, phase] of the key `transfer`; None where the table does not have it."""
    if not part.has("transfer"):
        return None
    rows = part.left.pop("transfer")
    if not (isinstance(rows, list) and all(isinstance(row, list) and len(row) == 3 for row in rows)):
        raise part.error("transfer", rows, "expected points such as ['60 Hz', '98 %', '-5 deg'], one below the other")
    if not FEWEST_POINTS <= len(rows) <= MOST_TRANSFER_POINTS:
        raise part.error("transfer", f"{len(rows)} points", f"expected {FEWEST_POINTS} to {MOST_TRANSFER_POINTS}")
    found = Transfer(
        tuple(part.checked("transfer", row[0], "Hz", exclusive=True) for row in rows),
        tuple(part.checked("transfer", row[1], "", exclusive=True) for row in rows),
        tuple(_read_phase_deg(part, row[2]) for row in rows),
    )
    hz = found.frequency_hz
    for before, after in itertools.pairwise(hz):
        if after <= before:
            raise part.error("transfer", f"{after:g} Hz", f"comes after {before:g} Hz; expected rising frequencies")
    if hz[0] > band_hz[0] * (1 + _BEYOND_POINTS) or hz[-1] < band_hz[1] * (1 - _BEYOND_POINTS):
        reach = f"expected points over all of the band, {band_hz[0]:g}-{band_hz[1]:g} Hz; measure more, or narrow it"
        raise part.error("transfer", f"{hz[0]:g}-{hz[-1]:g} Hz", reach)
    return found


def _read_electrodes(actuator: DeviceTable) -> Electrodes | None:
    """The electrodes that the table [actuator.electrodes] describes, or None for an actuator without such a table."""
    if not actuator.has("electrodes"):
        return None
    part = DeviceTable(actuator.source, f"{actuator.path}.electrodes", actuator.left.pop("electrodes"))
    part.inferred = actuator.inferred
    number, bias = part.integer("number", 1, 2), part.quantity("bias", "", exclusive=True)
    if bias >= 1:
        raise part.error("bias", f"{100 * bias:g} %", "expected less than 100 % of the greatest voltage")
    gap_deg = 180.0
    if part.has("phase_gap"):
        if number == 1:
            raise part.error("phase_gap", part.left["phase_gap"], "one electrode has none; leave it out")
        gap_deg = _read_phase_deg(part, part.left.pop("phase_gap"), "phase_gap")
        if not 0 < gap_deg < 360:
            raise part.error("phase_gap", f"{gap_deg:g} deg", "expected more than 0 and less than 360 deg")
    by = part.word("linearised_by", LINEARISERS, "nothing")
    if by == "board" and number == 2:
        raise part.error("linearised_by", by, "two electrodes half a turn apart are linear without; leave it out")
    part.close()
    return Electrodes(number, bias, gap_deg, by)


def check_transfers(source: str, actuators: tuple[Actuator, ...]) -> None:
    """Refuse points that no causal actuator has, or that are too far apart to tell, all before any is fitted."""
    found = {f"actuator[{i}].transfer": each.transfer for i, each in enumerate(actuators, 1) if each.transfer}
    points = sum(len(transfer.frequency_hz) for transfer in found.values())
    if points > MOST_TRANSFER_POINTS:
        remedy = f"expected at most {MOST_TRANSFER_POINTS} in all: leave out every other point"
        raise DeviceError(f"{source}: {', '.join(found)}: {points} points: {remedy}")
    for key, transfer in found.items():
        _check_causal(f"{source}: {key}: {len(transfer.frequency_hz)} points", transfer)


def _check_causal(where: str, found: Transfer) -> None:
    miss, growth = found.misses(), found.growth()
    remedy = "a delay makes phases fall with frequency: turn their sign if they rise, or measure more points"
    if miss.max() > GREATEST_MISS:
        worst = int(miss.argmax())
        point = f"misses {found.frequency_hz[worst]:g} Hz by {100 * miss[worst]:.0f} %"
        raise DeviceError(f"{where}: the nearest causal function {point}; {remedy}")
    if growth > GREATEST_GROWTH:
        grown = f"only a function that grows to {growth:.0f} times the greatest of them has these points"
        raise DeviceError(f"{where}: {grown}; {remedy}")


def check_electrodes(source: str, actuators: tuple[Actuator, ...]) -> None:
    """Refuse biases that differ where the board linearises: it has one law for all of its outputs."""
    parts = [each.electrodes for each in actuators if each.electrodes is not None]
    biases = sorted({part.bias for part in parts if part.linearised_by == "board"})
    if len(biases) > 1:
        shown = " and ".join(f"{100 * bias:g} %" for bias in biases)
        raise DeviceError(f"{source}: actuator[...].electrodes.bias: {shown}: a board has one bias; give one")


def _read_phase_deg(part: DeviceTable, text: object, key: str = "transfer") -> float:
    try:
        return math.degrees(read_angle_rad(text))
    except QuantityError as error:
        raise part.error(key, text, str(error)) from None


def read_sweep(part: DeviceTable) -> Sweep:
    """The table [sweep]."""
    start_hz = part.quantity("start", "Hz", exclusive=True)
    stop_hz = part.quantity("stop", "Hz", least=start_hz, exclusive=True)
    step_hz = part.quantity("step", "Hz", exclusive=True)
    steps = (stop_hz - start_hz) / step_hz
    if steps > _MOST_STEPS:
        raise part.error("step", f"{step_hz:g} Hz", f"expected at most {_MOST_STEPS} steps")
    if steps < 1 - 1e-6 or abs(steps - round(steps)) > 1e-6 * steps:
        raise part.error("step", f"{step_hz:g} Hz", f"must divide the range {start_hz:g}-{stop_hz:g} Hz evenly")
    return Sweep(
        start_hz=start_hz,
        stop_hz=stop_hz,
        step_hz=step_hz,
        amplitude_steps=part.integer("amplitude_steps", 1, 100),
        phase_steps=part.integer("phase_steps", 4, 360, 36),
        is_stored=part.flag("store", True),
    )


def check_damping(source: str, surface: Surface, actuators: tuple[Actuator, ...]) -> None:
    """Refuse a surface that nothing damps: its resonances would be infinite, and every figure near them meaningless."""
    undamped = surface.mass_damping_per_s == surface.stiffness_damping_s == 0
    if undamped and not any(each.damping_n_s_per_m for each in actuators):
        keys = f"{surface.kind}.mass_damping, {surface.kind}.stiffness_damping, actuator[...].damping"
        raise DeviceError(f"{source}: {keys}: all are 0: without damping resonances are infinite; give one of them")


def check_bands(source: str, actuators: tuple[Actuator, ...], sweep: Sweep) -> None:
    """Refuse an actuator whose band holds no frequency of the sweep."""
    for i, actuator in enumerate(actuators, 1):
        low_hz, high_hz = actuator.band_hz
        if not np.any((sweep.frequency_hz >= low_hz) & (sweep.frequency_hz <= high_hz)):
            grid = f"the sweep, {sweep.start_hz:g}-{sweep.stop_hz:g} Hz"
            raise DeviceError(f"{source}: actuator[{i}].band: {low_hz:g}-{high_hz:g} Hz: has no frequency of {grid}")


def read_spread(part: DeviceTable) -> Spread:
    """The table [spread]; what it leaves out is as in the set "bench"."""
    name = "" if part.left else "bench"
    name = part.name("name") if part.has("name") else name
    part.sentence("source")
    part.assume("stiffness", "mass", "finger", "finger_position")

    def fraction(key: str, default: str, below: float = _WIDEST_SPREAD) -> float:
        value = part.quantity(key, "", default=default)
        if value >= below:
            raise part.error(key, f"{100 * value:g} %", f"expected less than {100 * below:g} %")
        return value

    finger = None
    if part.left.get("finger") == PEOPLE:
        part.take_value("finger")
    else:
        finger = fraction("finger", "30 %", 1.0)
    return Spread(
        name=name,
        stiffness=fraction("stiffness", "1 %"),
        mass=fraction("mass", "1 %"),
        length=fraction("length", "0 %"),
        damping=fraction("damping", "0 %", 1.0),
        gain=fraction("gain", "0 %"),
        delay_s=part.quantity("delay", "s", default="0 s"),
        clamp_m=part.quantity("clamp", "m", default="0 mm"),
        finger=finger,
        finger_position_m=part.quantity("finger_position", "m", default="1 mm"),
        speed_m_per_s=part.quantity("speed", "m/s", default="0 m/s"),
    )


def read_levels(part: DeviceTable) -> tuple[float, ...]:
    """The levels of the table [feel], rising."""
    texts = part.take_value("levels", list(_LEVELS))
    if not isinstance(texts, list) or not 1 <= len(texts) <= _MOST_LEVELS:
        raise part.error("levels", texts, f"expected a list of 1 to {_MOST_LEVELS} levels such as ['10 dB', '20 dB']")
    levels_db = tuple(part.level_db("levels", text) for text in texts)
    if any(second <= first for first, second in itertools.pairwise(levels_db)):
        raise part.error("levels", texts, "expected rising levels")
    return levels_db


def read_limits(part: DeviceTable) -> Limits:
    """The table [limits]."""
    amplitude = part.quantity("amplitude", "", exclusive=True, default="100 %")
    if amplitude > 1:
        raise part.error("amplitude", f"{100 * amplitude:g} %", "expected at most 100 % of full scale")
    return Limits(
        amplitude=amplitude,
        slew_per_s=1.0 / part.quantity("ramp", "s", least=1e-6),
        lease_s=part.quantity("lease", "s", exclusive=True, default="40 ms"),
    )
