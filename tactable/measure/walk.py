"""A guided walk over the surface: the stops of the sensor and the tones to read there, and the run from stop to stop.

The raw samples and readings of a stop are kept in a folder as soon as the stop is complete. A run that was interrupted
goes on after the last complete stop; the folder refuses another device, walk, sensor or other options.
"""

import hashlib
import json
import math
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from enum import Enum
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from base.arrays import Array, Complex
from base.files import replace_file, write_text
from base.points import json_of, order_of, parts_of, point_of_json
from engine.device import Device
from precompute.calibration.measuring_plan import Accuracy, plan_first
from precompute.measurements.model import even_places
from precompute.measurements.parameters import default_names
from precompute.measurements.types import Kind, MeasurementError, Measurements
from tactable.measure.apparatus import Apparatus
from tactable.measure.driven_device import AskedDrive
from tactable.measure.faults import Fault
from tactable.measure.stepped_sine import (
    WINDOW_S,
    AtRest,
    Reading,
    SteppedSine,
    SteppedSineOptions,
    slowest_decay_per_s,
)
from tactable.measure.swept_sine import SweepOptions, SweptSine
from tactable.measure.tone_fit import is_beside_hum

_WITHIN = (0.1, 0.9)  # of the band that all actuators have: the two tones, 84 and 276 Hz of 60 to 300 Hz


@dataclass(frozen=True)
class Channel:
    """An output beside that of the first actuator: gain, negative for a turned plug, and how much later it plays."""

    gain: float
    delay_s: float

    def factor(self, frequency_hz: float) -> complex:
        """What its tone is to that of the first actuator."""
        return complex(self.gain * np.exp(-2j * np.pi * frequency_hz * self.delay_s))


def compare_channels(stepped: SteppedSine) -> tuple[Channel, ...]:
    """The channels of all actuators, the first 1 and 0 s; none where they have no loopbacks of their own or no signal.

    All actuators play one tone in phase, whose SET starts them on one sample; each loopback shows when and how strongly
    its own output plays. Loopbacks pass through one converter, so their ratio has neither clock nor latency in it. Two
    tones tell a delay from a plug that is turned. The responses of each actuator are relative to its own loopback,
    which is late by as much and hides what these ratios say: times the ratio they are relative to the command, and
    `calibrate` fits full scale and delay of each channel to them. Where records are equal to the last bit, they are of
    one channel, or of what was asked for: nothing is known then.

    Delays of up to half a period of the tones' difference are told, 2.6 ms of a band of 60 to 300 Hz. Raises as
    `SteppedSine.read`.
    """
    device, count = stepped.device, len(stepped.device.actuators)
    references = [index for i in range(count) if (index := stepped.reference(i)) is not None]
    low_hz = max(actuator.band_hz[0] for actuator in device.actuators)
    high_hz = min(actuator.band_hz[1] for actuator in device.actuators)
    if len(references) < max(count, 2) or low_hz >= high_hz:
        return ()
    tones_hz, ratios = list[float](), list[Complex]()
    for part in _WITHIN:
        hz = stepped.played_hz(low_hz + part * (high_hz - low_hz))
        asked = AskedDrive((hz,) * count, (stepped.options.least,) * count, (0.0,) * count)
        fit, values, faults = stepped.hold(asked)
        drives = values[:, references]
        if Fault.NO_SIGNAL in faults or Fault.LOST_SAMPLES in faults or (drives == drives[:, :1]).all():
            return ()
        tones_hz.append(hz)
        ratios.append(fit.phasor[references] / fit.phasor[references[0]])
    return channels_of(tones_hz, ratios)


def channels_of(tones_hz: Sequence[float], ratios: Sequence[Complex]) -> tuple[Channel, ...]:
    """Channels from their ratios (actuator,) to the first one at two rising frequencies."""
    omega, (low, high) = 2 * np.pi * np.array(tones_hz), ratios
    delay_s = -np.angle(high / low) / (omega[1] - omega[0])
    sign = np.where((low * np.exp(1j * omega[0] * delay_s)).real < 0, -1.0, 1.0)
    # The slope is known roughly; the phases themselves tell it to a fraction of that.
    off = np.angle(np.array(ratios) * sign * np.exp(1j * omega[:, None] * delay_s))
    delay_s = delay_s - (omega @ off) / (omega @ omega)
    gain = sign * np.abs(ratios).mean(axis=0)
    return tuple(Channel(*each) for each in zip(gain.tolist(), delay_s.tolist(), strict=True))


FREQUENCIES = 12  # with 8 places and 2 actuators 192 readings: 15 min at 4.7 s each (docs/results.md)
PLACES = 8
_CLEAR = 1.5  # windows; a reading has two or more, and a clock that drifts moves the tone a little
_FORM = 3
_IDENTITY = "measurement.json"
_DAMAGES = (OSError, EOFError, ValueError, LookupError, TypeError, AttributeError, RuntimeError, BadZipFile, zlib.error)
"""What NumPy and zipfile raise for files that are cut or of which bits are flipped."""


@dataclass(frozen=True)
class Stop:
    """A place of the sensor, and the tones to read there: (index of the actuator, frequency in Hz)."""

    position_m: complex
    tones: tuple[tuple[int, float], ...]


@dataclass(frozen=True)
class StopRecord:
    """Readings of a stop. latency_s: from drive to samples, None without loopback.

    channels: by actuator, as the loopbacks show them at the first stop; none where they do not tell.
    """

    position_m: complex
    rest: AtRest
    latency_s: float | None
    readings: tuple[Reading, ...]
    channels: tuple[Channel, ...] = ()


def even_walk(device: Device, places: int, frequencies_hz: Sequence[float] | None = None) -> tuple[Stop, ...]:
    """Every actuator at these frequencies of its band, at even places; by default FREQUENCIES beside the mains."""
    chosen_hz = default_frequencies(device) if frequencies_hz is None else frequencies_hz
    tones = tuple(
        (index, hz)
        for index, actuator in enumerate(device.actuators)
        for hz in chosen_hz
        if actuator.band_hz[0] <= hz <= actuator.band_hz[1]
    )
    if not tones:
        raise MeasurementError(f"{device.name}: no actuator can play any of these frequencies; choose some of a band")
    return tuple(Stop(position_m, tones) for position_m in even_places(device, places).tolist())


def default_frequencies(device: Device) -> list[float]:
    """Even frequencies over the sweep, each as near as it can be where no line of the mains is beside it."""
    low_hz, high_hz = device.sweep.start_hz, device.sweep.stop_hz
    grid_hz = np.arange(math.ceil(2 * low_hz), math.floor(2 * high_hz) + 1) / 2
    free_hz = grid_hz[[not is_beside_hum(hz, _CLEAR * WINDOW_S) for hz in grid_hz]]
    even_hz = np.linspace(low_hz, high_hz, FREQUENCIES)
    return sorted({float(free_hz[abs(free_hz - hz).argmin()]) for hz in even_hz})


def planned_walk(device: Device, readings: int, sensor_mass_kg: float) -> tuple[Stop, ...]:
    """The readings that `plan-measurements` proposes before any measurement, each actuator of a drive alone."""
    plan = plan_first(device, default_names(device), {}, sensor_mass_kg, Accuracy(), readings)
    tones: dict[complex, dict[tuple[int, float], None]] = {}
    for step in plan.steps:
        at = tones.setdefault(step.position_m, {})
        at.update({(index, hz): None for index, hz in enumerate(step.drive_hz) if not np.isnan(hz)})
    return tuple(Stop(position_m, tuple(sorted(tones[position_m]))) for position_m in sorted(tones, key=order_of))


class RawFolder:
    """Samples and readings by stop. Raises MeasurementError for a folder of another measurement.

    Each stop's file carries the hash of what the folder is for, so that one of another folder is refused as well.
    """

    def __init__(self, path: Path, device: Device, walk: Sequence[Stop], settings: dict[str, Any]) -> None:
        self.path = path
        stops = [[json_of(stop.position_m), [list(tone) for tone in stop.tones]] for stop in walk]
        text = json.dumps({"form": _FORM, "device": device.fingerprint, "stops": stops, **settings}, indent=1)
        self._identity = hashlib.sha256(text.encode()).hexdigest()
        path.mkdir(parents=True, exist_ok=True)
        file = path / _IDENTITY
        if not file.exists():
            write_text(file, text)
        elif file.read_bytes() != text.encode():
            raise MeasurementError(
                f"{path}: holds another measurement (another device, walk, sensor or level); give another output, or "
                "remove the folder"
            )

    def read(self, stop: Stop) -> StopRecord | None:
        """The record of a stop; None for one that is not complete."""
        file = self._file(stop)
        if not file.exists():
            return None
        try:
            with file.open("rb") as opened, np.load(opened, allow_pickle=False) as archive:
                kept = {name: archive[name] for name in archive.files}  # with the checksums of the samples, too
            record, found = _record_of(json.loads(str(kept["record"]))), json.loads(str(kept["identity"]))
        except _DAMAGES as error:
            raise MeasurementError(f"{file}: is damaged ({error}); remove it to measure this place again") from None
        if found != [self._identity, json_of(stop.position_m)]:
            raise MeasurementError(f"{file}: is of another measurement or place; remove it to measure this place again")
        return record

    def write(self, stop: Stop, record: StopRecord, samples: Sequence[Array]) -> None:
        """Keep a complete stop; samples (sample, channel) of each reading."""
        arrays: dict[str, Any] = {"identity": json.dumps([self._identity, json_of(stop.position_m)])}
        arrays |= {f"samples_{i:03d}": each.astype(np.float32) for i, each in enumerate(samples)}
        with replace_file(self._file(stop)) as partial, partial.open("wb") as file:
            np.savez_compressed(file, record=json.dumps(_record_json(record)), **arrays)

    def _file(self, stop: Stop) -> Path:
        return self.path / f"{'x'.join(f'{1e3 * part_m:07.2f}' for part_m in parts_of(stop.position_m))}mm.npz"


class Methods(Enum):
    """Names of the methods."""

    STEPPED = "stepped"
    SWEEP = "sweep"


@dataclass(frozen=True)
class Method:
    """How the tones of a stop are read: one after the other, or by sweeps of each actuator where there is a `sweep`."""

    stepped: SteppedSineOptions
    sweep: SweepOptions | None = None


def named_method(name: Methods, stepped: SteppedSineOptions) -> Method:
    """The method of a name, with the usual sweeps."""
    return Method(stepped, SweepOptions() if name is Methods.SWEEP else None)


def measure_walk(
    device: Device,
    walk: Sequence[Stop],
    apparatus: Apparatus,
    method: Method,
    raw: RawFolder,
    on_reading: Callable[[Stop, Reading], None] = lambda _stop, _reading: None,
) -> tuple[StopRecord, ...]:
    """Go from stop to stop, the sensor guided from one to the next. The board is armed at a stop only."""
    records, decay_per_s = list[StopRecord](), slowest_decay_per_s(device)
    for stop in walk:
        record = raw.read(stop)
        if record is None:
            apparatus.guide(stop.position_m)
            with apparatus.open_driven() as driven:
                stepped = SteppedSine(device, driven, apparatus.sensor, method.stepped, decay_per_s)
                rest, latency_s = stepped.listen(), stepped.measure_latency()
                channels = () if records else compare_channels(stepped)
                readings, samples = list[Reading](), list[Array]()
                for reading, values in _read_stop(stop, stepped, method.sweep):
                    on_reading(stop, reading)
                    readings.append(reading)
                    samples += values
            record = StopRecord(stop.position_m, rest, latency_s, tuple(readings), channels)
            raw.write(stop, record, samples)
        records.append(record)
    return tuple(records)


def _read_stop(stop: Stop, stepped: SteppedSine, sweep: SweepOptions | None) -> Iterator[tuple[Reading, list[Array]]]:
    """Each reading with the records (sample, channel) that it adds; those of a sweep come with its first reading."""
    if sweep is None:
        for actuator, hz in stop.tones:
            reading, values = stepped.read(actuator, hz)
            yield reading, [values]
        return
    swept = SweptSine(stepped, sweep)
    for actuator in sorted({actuator for actuator, _ in stop.tones}):
        wanted_hz = np.array([hz for which, hz in stop.tones if which == actuator])
        readings, records = swept.read(actuator, wanted_hz)
        yield from zip(readings, [records, *([] for _ in readings[1:])], strict=True)


def measurements_of(
    records: Sequence[StopRecord], device: Device, sensor_mass_kg: float, kind: Kind, *, is_simulated: bool
) -> Measurements:
    """The readings as `calibrate` takes them: responses, or their magnitudes as peaks. Raises MeasurementError.

    Where the loopbacks tell the channels apart, readings are of the commands, the first channel's delay and gain aside.
    """
    rows = [
        (record.position_m, reading)
        for record in records
        for reading in record.readings
        if not reading.is_spoiled and reading.acceleration != 0
    ]
    if not rows:
        raise MeasurementError("no reading is usable: every one is spoiled; see to the faults that were named")
    actuator = np.array([reading.actuator for _, reading in rows])
    driven = actuator[:, None] == np.arange(len(device.actuators))
    hz, amplitude = (np.array([getattr(r, key) for _, r in rows]) for key in ("frequency_hz", "amplitude"))
    channels = records[0].channels
    acceleration = np.array(
        [
            reading.acceleration * (channels[reading.actuator].factor(reading.frequency_hz) if channels else 1.0)
            for _, reading in rows
        ]
    )
    return Measurements(
        kind=kind,
        position_m=np.array([position_m for position_m, _ in rows]),
        frequency_hz=np.where(driven, hz[:, None], np.nan),
        amplitude=np.where(driven, amplitude[:, None], 0).astype(np.complex128),
        sensor_mass_kg=np.full(len(rows), sensor_mass_kg),
        finger_m=np.full(len(rows), np.nan),
        acceleration=acceleration if kind is Kind.RESPONSE else abs(acceleration).astype(np.complex128),
        is_simulated=is_simulated,
    )


def _record_json(record: StopRecord) -> dict[str, Any]:
    readings = [
        asdict(reading)
        | {
            "acceleration": [reading.acceleration.real, reading.acceleration.imag],
            "faults": [fault.name for fault in reading.faults],
            "earlier": [fault.name for fault in reading.earlier],
        }
        for reading in record.readings
    ]
    return asdict(record) | {"position_m": json_of(record.position_m), "readings": readings}


def _record_of(values: dict[str, Any]) -> StopRecord:
    readings = tuple(
        Reading(
            **each
            | {
                "acceleration": complex(*each["acceleration"]),
                "faults": tuple(Fault[name] for name in each["faults"]),
                "earlier": tuple(Fault[name] for name in each["earlier"]),
            }
        )
        for each in values["readings"]
    )
    channels = tuple(Channel(**each) for each in values["channels"])
    made = {"position_m": point_of_json(values["position_m"]), "rest": AtRest(**values["rest"])}
    return StopRecord(**values | made | {"readings": readings, "channels": channels})
