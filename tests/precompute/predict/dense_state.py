"""What a state of the fingers asks of a drive, from its definition: a dense model for every case, fingers assembled.

No low-rank update and no interpolation: at each frequency LAPACK solves the models of all cases, side by side in one
band matrix. Only which fingers there are is taken from precompute.sampling.fingers, as data.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy.sparse
from numpy.typing import NDArray
from scipy.linalg.lapack import zgbtrf, zgbtrs

from engine.device import Finger
from engine.touch import ZoneState
from precompute.sampling.fingers import PLACES, SampledFingers
from tests.precompute.dense_model import DenseModel, Fingers

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

THRESHOLD_DB = {
    40: 113.0, 60: 110.6, 80: 109.0, 100: 107.7, 125: 106.4, 150: 105.3,
    175: 104.4, 200: 103.6, 230: 102.8, 250: 102.3, 300: 105.5,
}  # fmt: skip
"""docs/theory.md#objective-and-bound: peak acceleration in dB re 1e-6 m/s^2 by frequency in Hz."""
_OFFSETS = (3, 2, 1, 0, -1, -2, -3)


def threshold(frequency_hz: float) -> float:
    """Peak acceleration in m/s^2, from 40 to 300 Hz."""
    assert 40 <= frequency_hz <= 300
    level_db = np.interp(np.log(frequency_hz), np.log(list(THRESHOLD_DB)), list(THRESHOLD_DB.values()))
    return float(1e-6 * 10 ** (level_db / 20))


def fingers_of(sampled: SampledFingers, case: int, zones: Sequence[int]) -> Fingers:
    """The fingers of one case in these zones: position and finger."""
    return [
        (
            float(sampled.position_m[zone, sampled.place[case, zone]]),
            Finger(
                mass_kg=float(sampled.mass_kg[case, zone]),
                damping_n_s_per_m=float(sampled.damping_n_s_per_m[case, zone]),
                stiffness_n_per_m=float(sampled.stiffness_n_per_m[case, zone]),
                spread=1.0,
            ),
        )
        for zone in zones
    ]


@dataclass
class DenseState:
    """One state: maximise min of numerators over max of denominators, every level at or above what is wanted.

    Numerators, denominators and levels are a^H H a of the drive a, summed over its frequencies; `loudest`: the levels
    are the numerators, and nothing is below. `bare` is the untouched bar.
    """

    bare: DenseModel
    sampled: SampledFingers
    states: tuple[ZoneState, ...]
    loudest: bool
    models: list[DenseModel] = field(init=False)
    """The bar under each case, the standard one first."""
    _rows: Any = field(init=False)  # scipy.sparse
    _known: dict[float, Complex] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        self.touched = self.zones_of(ZoneState.FELT, ZoneState.QUIET)
        self.felt, self.quiet = (
            [self.touched.index(zone) for zone in self.zones_of(state)] for state in (ZoneState.FELT, ZoneState.QUIET)
        )
        assert self.sampled.position_m.shape[1] == PLACES
        fingers = [fingers_of(self.sampled, case, self.touched) for case in range(len(self.sampled.place))]
        self.models = [self.bare.touched(on) for on in fingers]
        self._bands = [np.hstack([_band(getattr(model, name)) for model in self.models]) for name in "KCM"]
        self._rows = scipy.sparse.block_diag(
            [scipy.sparse.coo_array(self.bare.rows([at for at, _ in on])) for on in fingers], format="csr"
        )
        zones = self.bare.device.zones
        parts = [self.bare.square_integral(zone.start_m, zone.stop_m) for zone in zones]
        self._total = self.bare.square_integral(0.0, self.bare.device.bar.length_m)
        self._energy = sum((parts[zone] for zone in self.zones_of(ZoneState.FELT)), 0 * self._total)
        numerators = 1 if not self.quiet and not self.loudest else len(self.felt)
        denominators = 0 if self.loudest else len(self.quiet) or 1
        self.numerators = slice(0, numerators)
        self.denominators = slice(numerators, numerators + denominators)
        self.levels = slice(numerators + denominators, None)

    def zones_of(self, *kinds: ZoneState) -> list[int]:
        """Indices of the zones in one of these states."""
        return [zone for zone, state in enumerate(self.states) if state in kinds]

    def unit_fields(self, frequency_hz: float) -> Complex:
        """Displacement and its slope per hertz, shape (2, case, degree of freedom, actuator), at full scale."""
        K, C, M = self._bands
        omega, count = 2 * np.pi * frequency_hz, len(self.models)
        band = np.zeros((3 + len(_OFFSETS), K.shape[1]), dtype=np.complex128)  # LAPACK's room for pivoting above
        band[3:] = K + 1j * omega * C - omega**2 * M
        lu, pivots, failed = zgbtrf(band, 3, 3)
        assert not failed
        spring, damper = (np.tile(part, (count, 1)) for part in (self.bare.spring, self.bare.damper))
        field, _ = zgbtrs(lu, 3, 3, spring + 1j * omega * damper, pivots)
        turned = _product(1j * C - 2 * omega * M, field)
        slope, _ = zgbtrs(lu, 3, 3, 1j * damper - turned, pivots)
        both: Complex = np.stack([field, 2 * np.pi * slope]).reshape(2, count, -1, field.shape[1])
        return both

    def forms(self, frequency_hz: float) -> Complex:
        """Shape (2, form, actuator, actuator): numerators, denominators and levels, and their slopes per hertz."""
        if frequency_hz not in self._known:
            self._known[frequency_hz] = self._compute_forms(frequency_hz)
        return self._known[frequency_hz]

    def _compute_forms(self, frequency_hz: float) -> Complex:
        fields = self.unit_fields(frequency_hz)
        flat = fields.reshape(2, -1, fields.shape[3])
        under = np.stack([self._rows @ part for part in flat]).reshape(2, len(self.models), len(self.touched), -1)
        power = _weighted(_squares(under), *self._weight(frequency_hz))  # (2, case, finger, actuator, actuator)
        level, expected = power[:, 0, self.felt], power[:, 1:].mean(axis=1)
        if self.loudest:
            return np.concatenate([level, level], axis=1)
        standard = fields[:, 0]
        if not self.quiet:
            energies = [_integrated(standard, matrix) for matrix in (self._energy, self._total)]
            ratio = _weighted(np.stack(energies, axis=1), frequency_hz**2, 2 / frequency_hz)
            return np.concatenate([ratio, level], axis=1)
        return np.concatenate([expected[:, self.felt], expected[:, self.quiet], level], axis=1)

    def _weight(self, frequency_hz: float) -> tuple[float, float]:
        """Power over threshold of a displacement squared, and the slope of its logarithm per hertz."""

        def logarithm(hz: float) -> float:
            return float(4 * np.log(2 * np.pi * hz) - 2 * np.log(threshold(hz)))

        below, above = max(frequency_hz - 1e-3, 40.0), min(frequency_hz + 1e-3, 300.0)
        return float(np.exp(logarithm(frequency_hz))), (logarithm(above) - logarithm(below)) / (above - below)

    def powers(self, frequency_hz: Array, amplitude: Complex) -> Array:
        """Shape (form,): of a drive with one frequency and complex amplitude an actuator."""
        total = np.zeros(self.forms(float(frequency_hz[0])).shape[1])
        for hz in np.unique(frequency_hz[amplitude != 0]):
            part = np.where(frequency_hz == hz, amplitude, 0)
            total += np.einsum("a,iab,b->i", part.conj(), self.forms(float(hz))[0], part).real
        return total

    def judge(self, powers: Array) -> tuple[Array, Array]:
        """The ratio and the power over threshold under the weakest felt finger; powers (..., form)."""
        ratio = powers[..., self.numerators].min(axis=-1)
        if not self.loudest:
            ratio = ratio / powers[..., self.denominators].max(axis=-1)
        return ratio, powers[..., self.levels].min(axis=-1)

    def under_fingers(self, frequency_hz: Array, amplitude: Complex) -> tuple[Array, Array]:
        """Acceleration, magnitudes of the tones added, and power over threshold: each (case, finger)."""
        acceleration = np.zeros((len(self.models), len(self.touched)))
        power = np.zeros_like(acceleration)
        for hz in np.unique(frequency_hz[amplitude != 0]):
            field = self.unit_fields(float(hz))[0] @ np.where(frequency_hz == hz, amplitude, 0)
            level = abs(self._rows @ field.ravel()).reshape(acceleration.shape) * (2 * np.pi * hz) ** 2
            acceleration += level
            power += (level / threshold(float(hz))) ** 2
        return acceleration, power


def _band(matrix: Array) -> Array:
    """The diagonals of _OFFSETS, columns in place: LAPACK's and scipy.sparse's band form."""
    size = len(matrix)
    out = np.zeros((len(_OFFSETS), size))
    for row, offset in zip(out, _OFFSETS, strict=True):
        row[max(offset, 0) : size + min(offset, 0)] = np.diagonal(matrix, offset)
    assert np.count_nonzero(out) == np.count_nonzero(matrix)
    return out


def _product(bands: NDArray[np.complexfloating], columns: Complex) -> Complex:
    """The band matrix times columns."""
    matrix: Any = scipy.sparse.dia_array((bands, np.array(_OFFSETS)), shape=(len(columns), len(columns)))
    product: Complex = matrix @ columns
    return product


def _squares(values: Complex) -> Complex:
    """conj(y_a) y_b and its slope, (2, ..., actuator, actuator), from y and its slope (2, ..., actuator)."""
    y, slope = values
    cross = y.conj()[..., :, None] * slope[..., None, :]
    return np.stack([y.conj()[..., :, None] * y[..., None, :], cross + cross.conj().swapaxes(-1, -2)])


def _integrated(field: Complex, matrix: Array) -> Complex:
    """y^H Z y and its slope, (2, actuator, actuator), from y and its slope (2, degree of freedom, actuator)."""
    y, slope = field
    cross = y.conj().T @ matrix @ slope
    return np.stack([y.conj().T @ matrix @ y, cross + cross.conj().T])


def _weighted(forms: Complex, weight: float, log_slope: float) -> Complex:
    return np.stack([weight * forms[0], weight * (forms[1] + log_slope * forms[0])])
