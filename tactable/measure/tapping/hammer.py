"""A surface tapped with a hammer, at one place after the other: to responses per newton, or to modes and shapes.

With a force channel the sensor stays and the hammer roves; the file has responses per newton, which `calibrate` fits
and `build --responses --force-of-actuators` takes. Without one it has modes. Shapes need a second accelerometer that
stays ("reference") while the first one roves, since the strength of a tap is not known; the taps may be anywhere.
"""

import select
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from base.arrays import Array, Complex, Points
from base.points import point_text
from engine.device import Actuator, Device, Finger
from precompute.measurements.columns import split_places
from precompute.measurements.pick import pick_modes, residues_of, write_modes
from precompute.measurements.types import Kind, Measurements, nearest_actuator
from precompute.model.assembly import assemble
from precompute.model.modal import compute_basis
from precompute.model.transient import TransientPlant
from tactable.audio.names import AudioInput, is_audio, parse_input
from tactable.measure.apparatus import open_sensor
from tactable.measure.audio_process import form_of
from tactable.measure.driven_device import PATIENCE_NS
from tactable.measure.sensor import ACCELERATION, FORCE, REFERENCE, SampleStream, Sensor, SensorError, SensorForm
from tactable.measure.simulated_bench import Converter, ConverterFlaws
from tactable.measure.tapping.taps import Tap, decay_of, find_taps, response_of

RATE_HZ, _PLANT_SAMPLES = 24_000.0, 2
_SOFTEST_N_PER_M = 1e-3  # spring of the stand-in: a millionth of an actuator's
_CONTACT_S, _WEAKEST_N, _STRONGEST_N = 1.5e-3, 0.4, 1.0  # of a small hammer on a bar of some grams


class TapBench:
    """A surface with a sensor that stays at `sensor_m`, the load cell of the hammer, and their converter. SIMULATED.

    A tap is a half-sine of force: an actuator that is nothing but a force stands at its place in the model.
    """

    def __init__(
        self, device: Device, flaws: ConverterFlaws, seed: int, sensor_m: complex, sensor_mass_kg: float
    ) -> None:
        self._device, self._sensor_m, self._random = device, sensor_m, np.random.default_rng(seed)
        self._sensor = Finger(sensor_mass_kg, 0.0, 0.0, 1.0)
        clips_at = (flaws.clips_at_m_per_s2, np.inf)
        self.form = SensorForm(RATE_HZ, (ACCELERATION, FORCE), clips_at, is_simulated=True)
        self._converter = Converter(flaws, self.form, False, self._random)

    def record(self, position_m: complex, times_s: Sequence[float], seconds: float) -> Array:
        """Samples (sample, channel) of contacts at these times, at one place, each with a force of its own."""
        plant_hz = RATE_HZ * _PLANT_SAMPLES
        time_s = np.arange(round(seconds * plant_hz)) / plant_hz
        force_n = np.zeros(len(time_s))
        for start_s in times_s:
            within = (time_s >= start_s) & (time_s < start_s + _CONTACT_S)
            strength_n = self._random.uniform(_WEAKEST_N, _STRONGEST_N)
            force_n[within] += strength_n * np.sin(np.pi * (time_s[within] - start_s) / _CONTACT_S)
        spring = _SOFTEST_N_PER_M
        hammer = Actuator("hammer", position_m, spring, 0.0, 0.0, 1 / spring, (1.0, RATE_HZ), is_force=True)
        tapped = replace(self._device, actuators=(*self._device.actuators, hammer))
        plant = TransientPlant(compute_basis(assemble(tapped)), np.array([self._sensor_m]), plant_hz)
        plant.touch([(self._sensor_m, self._sensor)])
        drive = np.zeros((len(time_s), len(tapped.actuators)))
        drive[:, -1] = force_n
        kept = slice(None, None, _PLANT_SAMPLES)
        return self._converter.convert(plant.accelerate(drive)[kept, 0], force_n[kept, None], time_s[kept])


_ROUNDS = 3  # in which a place may give its taps
_PICKED_LINES = 480  # of a decay: enough for two dozen modes, and a fit of seconds
Record = Callable[[complex], tuple[list[Tap], bool]]
"""The next taps of a place, and whether more can be had there."""


@dataclass(frozen=True)
class HammerOptions:
    """places_m: of what roves. fixed_m: of what stays, the sensor beside a force channel, else the reference."""

    places_m: tuple[complex, ...]
    fixed_m: complex
    taps: int
    pause_s: float
    sensor_mass_kg: float


@dataclass(frozen=True)
class Tapped:
    """The good taps of each place, and the form of their samples."""

    options: HammerOptions
    form: SensorForm
    taps: tuple[tuple[Tap, ...], ...]

    def responses(self, device: Device, frequency_hz: Array) -> tuple[Measurements, Array]:
        """Responses per newton at every place of the hammer, and their standard errors (row,). Raises SensorError."""
        found = [response_of(taps, self.form, frequency_hz) for taps in self.taps]
        force_m, count = np.repeat(self.options.places_m, len(frequency_hz)), len(found)
        value, error = (np.concatenate([each[part] for each in found]) for part in (0, 1))
        place_m = np.full(len(value), self.options.fixed_m)
        return self._rows(device, np.tile(frequency_hz, count), place_m, force_m, value), error

    def modes(self, device: Device, frequency_hz: Array, source: str) -> str:
        """CSV text of the modes, with shapes where they are known. Raises MeasurementError without a mode."""
        hz = np.linspace(frequency_hz[0], frequency_hz[-1], _PICKED_LINES)
        if FORCE in self.form.channels:
            read, _ = self.responses(device, hz)
            picked = pick_modes(read, source)
            found = residues_of(read, picked, source)
            return write_modes(picked, read, source, _along(found.drive, found.value))
        has_reference = REFERENCE in self.form.channels
        channels = (ACCELERATION, REFERENCE) if has_reference else (ACCELERATION,)
        # A tap has no known strength: each counts as a force at a place of its own, and so does each channel.
        value = [decay_of(tap, self.form, channel, hz) for taps in self.taps for tap in taps for channel in channels]
        tag = np.repeat(np.arange(len(value)), len(hz)) * device.surface.length_m / len(value)
        fixed_m = np.full(len(tag), self.options.fixed_m)
        read = self._rows(device, np.tile(hz, len(value)), fixed_m, tag + 0 * fixed_m, np.concatenate(value))
        picked = pick_modes(read, source)
        if not has_reference:
            return write_modes(picked, read, source)
        moved = residues_of(read, picked, source).value.reshape(len(picked), -1, 2)
        place_m = np.repeat(self.options.places_m, [len(taps) for taps in self.taps])
        return write_modes(picked, read, source, _along(place_m, moved[..., 0] / moved[..., 1]))

    def _rows(self, device: Device, hz: Array, position_m: Points, force_m: Points, value: Complex) -> Measurements:
        driven = nearest_actuator(device, force_m)[:, None] == np.arange(len(device.actuators))
        return Measurements(
            kind=Kind.RESPONSE,
            position_m=position_m,
            frequency_hz=np.where(driven, hz[:, None], np.nan),
            amplitude=driven.astype(np.complex128),
            sensor_mass_kg=np.full(len(hz), self.options.sensor_mass_kg),
            finger_m=np.full(len(hz), np.nan),
            acceleration=value,
            is_simulated=self.form.is_simulated,
            force_m=force_m,
        )


def _along(place_m: Points, value: Complex) -> tuple[Points, Complex]:
    """Places in order, and at each the mean of the deflections (mode, tap)."""
    places_m: Any = np.unique(place_m)
    shape: Complex = np.array([value[:, place_m == at_m].mean(axis=1) for at_m in places_m], np.complex128).T
    return places_m, shape


def tap_places(
    form: SensorForm, options: HammerOptions, record: Record, tell: Callable[[complex, Sequence[Tap]], None]
) -> Tapped:
    """Take the taps of every place, those that are spoiled told and left out. Raises SensorError where none is good."""
    kept = []
    for place_m in options.places_m:
        good = list[Tap]()
        for _ in range(_ROUNDS):
            taps, has_more = record(place_m)
            tell(place_m, taps)
            good += [tap for tap in taps if not tap.faults]
            if len(good) >= options.taps or not has_more:
                break
        if not good:
            why = taps[0].text if taps else "none stands out of the noise: tap harder, or check channels and scales"
            raise SensorError(f"no good tap at {point_text(place_m)}: {why}")
        kept.append(tuple(good))
    return Tapped(options, form, tuple(kept))


@contextmanager
def open_taps(
    device: Device, sensor: str, options: HammerOptions, bench: TapBench | None, ask: Callable[[str], None]
) -> Iterator[tuple[SensorForm, Record]]:
    """The form of the samples and what takes the taps of a place: simulated, of a recording, or of a converter."""
    if bench is not None:
        times_s = [0.2 + k * options.pause_s for k in range(options.taps)]
        seconds = options.taps * options.pause_s + 0.2
        yield bench.form, lambda at_m: (find_taps(bench.record(at_m, times_s, seconds), bench.form), False)
    elif (recorded := _read_recording(sensor, device)) is not None:
        form, values = recorded
        left = find_taps(values, form)
        wanted = options.taps * len(options.places_m)
        if len(left) != wanted:
            times = ", ".join(f"{tap.time_s:.2f}" for tap in left[:40])
            raise SensorError(
                f"{sensor}: has {len(left)} taps, at {times} s; expected {wanted}: {options.taps} at each of "
                f"{len(options.places_m)} places. Give taps in --hammer and --places that fit, or cut the recording"
            )
        yield form, lambda _: ([left.pop(0) for _ in range(options.taps)], False)
    else:
        live = open_sensor(sensor, device)
        roves = "hammer" if FORCE in live.form.channels or REFERENCE not in live.form.channels else "sensor"
        seconds = options.taps * options.pause_s

        def record(at_m: complex) -> tuple[list[Tap], bool]:
            ask(f"{roves} to {point_text(at_m, 1, 'f')}, then Enter, and {options.taps} taps within {seconds:g} s")
            return find_taps(_listen(live, seconds), live.form, least=0), True

        with closing(live):
            yield live.form, record


def _listen(sensor: Sensor, seconds: float) -> Array:
    """The samples (sample, channel) of the next seconds. Raises SensorError where the converter stops."""
    while sensor.read() is not None:
        pass
    blocks, wanted = [np.empty((0, len(sensor.form.channels)))], round(seconds * sensor.form.sample_rate_hz)
    while sum(map(len, blocks)) < wanted:
        if not select.select([sensor.fileno()], [], [], PATIENCE_NS / 1e9)[0]:
            raise SensorError(f"no samples for {PATIENCE_NS / 1e9:g} s: start the converter and its program")
        if (block := sensor.read()) is not None:
            blocks.append(block.values)
    return np.concatenate(blocks)[:wanted]


def _read_recording(sensor: str, device: Device) -> tuple[SensorForm, Array] | None:
    """Form and samples (sample, channel) of a recording: a WAV file, or a file of samples. None for a converter."""
    if is_audio(sensor):
        source = parse_input(sensor, [actuator.name for actuator in device.actuators])
        return _read_wav(source) if source.name.lower().endswith(".wav") else None
    if not Path(sensor).is_file():
        return None
    with closing(SampleStream(Path(sensor), device)) as stream:
        block = stream.read()
        if block is None:
            raise SensorError(f"{sensor}: has no samples")
        return stream.form, block.values


def _read_wav(source: AudioInput) -> tuple[SensorForm, Array]:
    from scipy.io import wavfile

    form, columns = form_of(source, []), [source.acceleration, *(channel for _, channel, _ in source.further)]
    try:
        rate_hz, samples = wavfile.read(source.name)
    except (OSError, ValueError) as error:
        raise SensorError(f"{source.name}: is no WAV file: {error}; export it as 16 or 32 bit PCM") from None
    values = samples.reshape(len(samples), -1).astype(np.float64)
    if np.issubdtype(samples.dtype, np.signedinteger):
        values /= np.iinfo(samples.dtype).max
    if (most := max(columns)) >= (count := values.shape[1]):
        raise SensorError(f"{source.name}: has {count} channels, and the text names channel {most + 1}; correct it")
    return replace(form, sample_rate_hz=float(rate_hz)), values[:, columns] * form.clips_at  # a sample of 1 is the end


def responses_text(found: Measurements, device: Device, comment: str) -> str:
    """CSV text of responses per newton, as `read_measurements` reads it."""
    assert found.force_m is not None
    places = split_places(device, "position", found.position_m) | split_places(device, "force position", found.force_m)
    value, parts = found.acceleration, (f"accelerance {part} (m/s^2/N)" for part in ("real", "imaginary"))
    titles = ",".join([*(f"{name} (mm)" for name in places), "frequency (Hz)", "sensor mass (g)", *parts])
    hz, mass_g = np.nanmax(found.frequency_hz, axis=1), 1e3 * found.sensor_mass_kg
    rows = np.column_stack([*(1e3 * each for each in places.values()), hz, mass_g, value.real, value.imag])
    return "\n".join([f"# {comment}", titles, *(",".join(f"{cell:.9g}" for cell in row) for row in rows), ""])
