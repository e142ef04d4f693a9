"""Sampled plants and windowed tones to what every finger feels of each tone, over time."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from engine.device import Device
from precompute.model.assembly import assemble
from precompute.model.modal import Basis, ModalModel, compute_basis, compute_modal_model
from precompute.model.threshold_filter import LENGTH_S as FILTER_S
from precompute.model.threshold_filter import threshold_filter
from precompute.model.transient import step_integrals
from precompute.sampling.plants import Scenarios

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

PLAY_RATE_HZ = 4000.0
"""Of a waveform's samples; between them the device moves in straight lines."""
LOOKS = 2
"""Instants looked at for each sample: at 300 Hz a peak between them is missed by less than 0.06 dB."""
LOOK_RATE_HZ = LOOKS * PLAY_RATE_HZ
RING_S = 0.2
"""How long after the click's end the fingers are looked at."""
MODES = 16
"""Those up to 4 kHz on the published bar; the others change what is felt by less than 0.1 %."""

_ALIKE = 1e-3
_AT_ONCE = 16
"""Scenarios played at once: what they take stays near the processor."""


@dataclass(frozen=True)
class Tones:
    """Windowed tones that a click is made of: wave (tone, time) at PLAY_RATE_HZ, and who plays each, actuator (tone,).

    Both ends of every wave are 0.
    """

    wave: Array
    actuator: NDArray[np.int64]

    def waveform(self, weight: Array) -> Array:
        """Base displacements (actuator, time), fractions of full scale, of the weights (tone,)."""
        actuators = int(self.actuator.max()) + 1
        return np.stack([weight[mine] @ self.wave[mine] for mine in (self.actuator == i for i in range(actuators))])


@dataclass(frozen=True)
class Responses:
    """What fingers feel, over threshold, in every scenario: spectrum (scenario, finger, actuator, frequency).

    Of one sample at full scale, reached and left in straight lines within a step of LOOK_RATE_HZ. `steps`: instants
    that are looked at, from the click's start.
    """

    spectrum: Complex
    steps: int

    def under(self, fingers: Sequence[int]) -> "Responses":
        """Those of some fingers only."""
        return Responses(self.spectrum[:, list(fingers)], self.steps)

    def first(self, scenarios: int) -> "Responses":
        """Those of the first scenarios only."""
        return Responses(self.spectrum[:scenarios], self.steps)

    def mean(self) -> "Responses":
        """One scenario, in which everything is felt as on average."""
        return Responses(self.spectrum.mean(axis=0, keepdims=True), self.steps)

    def play(self, waveform: Array) -> Array:
        """Weighted acceleration (scenario, finger, time) at LOOK_RATE_HZ of base displacements (actuator, time)."""
        size = _transform_size(self.steps)
        return _played(self.spectrum, scipy.fft.rfft(between(waveform), size), size)[..., : self.steps]

    def peaks(self, waveform: Array, fingers: Sequence[int]) -> Array:
        """Greatest magnitudes (scenario, finger) of what `play` gives, of some fingers, without keeping all of it."""
        size, peaks = _transform_size(self.steps), list[Array]()
        drive = scipy.fft.rfft(between(waveform), size)
        for start in range(0, len(self.spectrum), _AT_ONCE):
            spectrum = self.spectrum[start : start + _AT_ONCE, list(fingers)]
            peaks.append(np.abs(_played(spectrum, drive, size)[..., : self.steps]).max(axis=2))
        return np.concatenate(peaks)

    def play_each(self, tones: Tones, every: int = 1) -> Array:
        """Weighted acceleration (scenario, finger, time, tone) of every tone by itself, at each `every`th instant."""
        size = _transform_size(self.steps)
        drive = scipy.fft.rfft(between(tones.wave), size)
        out = np.empty((*self.spectrum.shape[:2], -(-self.steps // every), len(drive)))
        for scenario, spectrum in enumerate(self.spectrum):
            felt = scipy.fft.irfft(spectrum[:, tones.actuator] * drive, size)
            out[scenario] = felt[..., : self.steps : every].transpose(0, 2, 1)
        return out


def _played(spectrum: Complex, drive: Complex, size: int) -> Array:
    """Summed over the actuators: (scenario, finger, time)."""
    total = spectrum[:, :, 0] * drive[0]
    for actuator in range(1, len(drive)):
        total += spectrum[:, :, actuator] * drive[actuator]
    felt: Array = scipy.fft.irfft(total, size)
    return felt


def make_tones(device: Device, length_s: float, crowding: float = 1.0) -> Tones:
    """Half-sine window of that length times cosines and sines in each actuator's band, `crowding` each 1 / length_s."""
    samples = round(length_s * PLAY_RATE_HZ)
    time_s = (np.arange(samples + 1) - samples / 2) / PLAY_RATE_HZ
    window = np.cos(np.pi * time_s / length_s)
    window[[0, -1]] = 0
    waves, players = list[Array](), list[int]()
    for index, actuator in enumerate(device.actuators):
        for tone_hz in _spread_over(actuator.band_hz, 1 / (crowding * length_s)):
            turn = 2 * np.pi * tone_hz * time_s
            waves += [window * np.cos(turn), window * np.sin(turn)]
            players += [index, index]
    return Tones(np.array(waves), np.array(players, dtype=np.int64))


def independent(tones: Tones) -> Tones:
    """Sums of them, orthogonal and as large as a tone; those that differ by nothing are left out.

    Crowded tones are nearly sums of one another, and programs over them ill-conditioned.
    """
    waves, players = list[Array](), list[NDArray[np.int64]]()
    for actuator in np.unique(tones.actuator):
        _, size, sums = np.linalg.svd(tones.wave[tones.actuator == actuator], full_matrices=False)
        kept = size > _ALIKE * size[0]
        waves.append(sums[kept] * size[0])
        players.append(np.full(np.count_nonzero(kept), actuator))
    wave = np.concatenate(waves)
    wave[:, [0, -1]] = 0  # where rounding leaves something
    return Tones(wave, np.concatenate(players))


def compute_bases(scenarios: Scenarios) -> list[Basis]:
    """The modes of every scenario's bar, untouched."""
    return [compute_basis(assemble(scenarios.device_of(s)), MODES) for s in range(len(scenarios))]


def compute_responses(
    scenarios: Scenarios, bases: Sequence[Basis], touched: Sequence[int], longest_s: float
) -> Responses:
    """Responses under a finger in each of the zones `touched` (indices), for clicks of up to `longest_s`."""
    steps = round((longest_s + RING_S) * LOOK_RATE_HZ)
    size = _transform_size(steps)
    weighting = scipy.fft.rfft(threshold_filter(LOOK_RATE_HZ), size)
    shape = (len(scenarios), len(touched), len(scenarios.device.actuators), len(weighting))
    spectrum = np.empty(shape, dtype=np.complex128)
    for scenario, sample in enumerate(_sample_responses(scenarios, bases, touched, steps)):
        spectrum[scenario] = scipy.fft.rfft(sample, size) * weighting
    return Responses(spectrum, steps)


def between(wave: Array) -> Array:
    """The same straight lines (..., time), sampled LOOKS times as often."""
    samples = wave.shape[-1]
    at = np.arange((samples - 1) * LOOKS + 1) / LOOKS
    left = np.minimum(at.astype(np.int64), samples - 2)
    part = at - left
    lines: Array = wave[..., left] * (1 - part) + wave[..., left + 1] * part
    return lines


def _sample_responses(
    scenarios: Scenarios, bases: Sequence[Basis], touched: Sequence[int], steps: int
) -> Iterator[Array]:
    for scenario, basis in enumerate(bases):
        fingers = scenarios.fingers_of(scenario, touched)
        model = compute_modal_model(basis, fingers)
        yield _sample_response(model, np.array([position_m for position_m, _ in fingers]), steps)


def _sample_response(model: ModalModel, position_m: Array, steps: int) -> Array:
    """Acceleration (place, actuator, time) after one sample at full scale, in closed form.

    The states of precompute.model.transient, whose steps these are, seen through the mode shapes.
    """
    step_s, modes = 1 / LOOK_RATE_HZ, len(model.basis.square_omega)
    kept = np.flatnonzero(model.pole.imag >= 0)  # of a conjugate pair one is enough, counted twice
    pole, spring, damper = model.pole[kept], model.spring[kept], model.damper[kept]
    phi_1, phi_2 = (integral[:, None] for integral in step_integrals(pole, step_s))
    rising = (phi_1 * damper + phi_2 * spring) / step_s
    falling = np.exp(pole * step_s)[:, None] * rising + phi_1 * spring - rising
    place = model.basis.at(position_m)
    seen = place @ (model.vector[modes:, kept] * pole * np.where(pole.imag > 0, 2.0, 1.0))
    out = np.empty((len(position_m), spring.shape[1], steps))
    decay = _powers(np.exp(pole * step_s), steps - 1)
    for actuator in range(spring.shape[1]):
        out[:, actuator, 0] = (seen @ rising[:, actuator]).real
        out[:, actuator, 1:] = ((seen * falling[:, actuator]) @ decay).real
    direct, rate = place @ model.push[:, 0], place @ model.push[:, 1] / step_s
    out[..., 0] += direct + rate
    out[..., 1] -= rate
    return out


def _powers(base: Complex, count: int) -> Complex:
    """Shape (base, count): the powers from 0 on, each of two factors, for every exponential takes its time."""
    block = math.isqrt(count) + 1
    small, large = base[:, None] ** np.arange(block), base[:, None] ** (block * np.arange(block))
    powers: Complex = (large[:, :, None] * small[:, None, :]).reshape(len(base), -1)[:, :count]
    return powers


def _spread_over(band_hz: tuple[float, float], spacing_hz: float) -> Array:
    """Frequencies of that spacing in the middle of the band."""
    low_hz, high_hz = band_hz
    gaps = int((high_hz - low_hz) / spacing_hz * (1 + 1e-12))
    start_hz = (low_hz + high_hz - gaps * spacing_hz) / 2
    tones_hz: Array = start_hz + spacing_hz * np.arange(gaps + 1, dtype=np.float64)
    return tones_hz


def _transform_size(steps: int) -> int:
    """Long enough that nothing comes round: a click, what its last sample does, and the filter, one after another."""
    click, taps = steps - round(RING_S * LOOK_RATE_HZ), round(FILTER_S * LOOK_RATE_HZ)
    return int(scipy.fft.next_fast_len(click + steps + taps, real=True))
