"""Complex responses to the modes that all of them share, by a rational fit with common poles.

Vector fitting (Gustavsen and Semlyen, IEEE Trans. Power Delivery 14, 1999): with poles p the responses H and a common
function S = 1 + sum c / (s - p) are fitted by S H = sum r / (s - p) + d + e s + f s^2, which is linear; the zeros of S
are better poles. The mirror images of the data, at -j omega, make the poles conjugate. Poles are added while they lower
the misfit beyond chance (Schwarz, Ann. Statist. 6, 1978). Standard errors are those of the jackknife, a fifth of the
lines left out at a time. ESTIMATE.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from base.arrays import Array, Complex, Points
from base.points import parts_of, point_text
from precompute.measurements.columns import SIMULATED
from precompute.measurements.types import Kind, MeasurementError, Measurements

Channel = tuple[Complex, Complex]  # s in units of the highest frequency, of both signs, and the response there

_MOST_PAIRS = 24
_PATIENCE = 2  # numbers of poles that may lower the misfit no more before the search ends
_ROUNDS, _FOLDS = 6, 5
_FEWEST_LINES = 10
_LEAST_MISFIT = 1e-5  # relative: files have six digits
_FLOOR = 1e-3  # of the greatest response: smaller ones are weighted like it
_POLYNOMIAL = np.arange(3)  # residual of the modes beyond the band
_UNSURE, _MOST_DAMPING = 0.5, 0.5  # relative error of a damping, and a damping, beyond which a pole is no mode


def pick_modes(measurements: Measurements, source: str) -> Array:
    """Frequency in Hz, damping ratio and the standard errors of both (mode, 4) of the modes within the band.

    One actuator moves in each row, or a force of 1 N; the scale of a response does not matter. Raises MeasurementError.
    """
    lines = _split(measurements, source)
    top = 2 * np.pi * max(float(line.frequency_hz.max()) for line in lines)
    channels = [line.channel(top) for line in lines]
    with threadpool_limits(1, "blas"):
        poles = _search(channels, min(float(abs(s).min()) for s, _ in channels))
        parts = [_relocate([_without(k, *channel) for channel in channels], poles) for k in range(_FOLDS)]
    modes = []
    for pole in sorted(poles, key=abs):
        near = np.array([part[np.argmin(abs(part - pole))] for part in parts])
        size, damping = abs(pole), -pole.real / abs(pole)
        off = np.stack([abs(near) - size, -near.real / abs(near) - damping])
        error = np.sqrt((_FOLDS - 1) * (off**2).mean(axis=1))
        within = pole.imag > 0 and min(abs(s).min() for s, _ in channels) <= size <= 1
        if within and damping < _MOST_DAMPING and error[1] < _UNSURE * damping and error[0] < _UNSURE * size * damping:
            modes.append((size * top / (2 * np.pi), damping, error[0] * top / (2 * np.pi), error[1]))
    if not modes:
        raise MeasurementError(f"{source}: no mode stands out of these responses; measure closer frequencies")
    return np.array(modes)


class Residues(NamedTuple):
    """Residues (mode, response) of responses with common modes.

    drive, position_m (response,): index of the actuator, or place of the force, and place of the sensor. With one force
    they are deflections at the sensor, with one sensor those at the force; the scale of each mode is its own.
    """

    drive: Points
    position_m: Points
    value: Complex


def residues_of(measurements: Measurements, modes: Array, source: str) -> Residues:
    """Residues of the modes (mode, 2 or more) that `pick_modes` found, by linear least squares."""
    lines = _split(measurements, source)
    top = 2 * np.pi * max(float(line.frequency_hz.max()) for line in lines)
    size, damping = 2 * np.pi / top * modes[:, 0], modes[:, 1]
    upper = size * (1j * np.sqrt(1 - damping**2) - damping)
    poles = np.concatenate([upper, upper.conj()])
    found = []
    for line in lines:
        terms, _, response = _weighted(*line.channel(top), poles)
        found.append(np.linalg.lstsq(terms, response, rcond=None)[0][: len(upper)])
    drive, position_m = (np.array([line[k] for line in lines]) for k in (0, 1))
    return Residues(drive, position_m, np.array(found).T)


def write_modes(
    modes: Array, measurements: Measurements, source: str, shapes: tuple[Points, Complex] | None = None
) -> str:
    """CSV text of modes that were picked from the measurements, as `read_modes` reads it.

    shapes: places (place,) and deflections (mode, place) there, where they are known.
    """
    simulated = f"{SIMULATED}, " if measurements.is_simulated else ""
    comment = f"# {simulated}picked from {Path(source).name}; errors are ESTIMATES"
    header = "frequency (Hz),damping ratio (%),frequency error (Hz),damping ratio error (%)"
    place_m = parts_of(measurements.position_m[0])
    header += "".join([",sensor mass (g),sensor position (mm)", ",sensor position across (mm)"][: len(place_m)])
    where = 1e3 * np.array([measurements.sensor_mass_kg[0], *place_m])
    rows = [",".join(f"{value:.8g}" for value in (*row, *where)) for row in modes * [1, 100, 1, 100]]
    if shapes is not None:
        real = [(row / row[abs(row).argmax()]).real.tolist() for row in shapes[1]]  # each mode has a scale of its own
        header += "".join(f",shape at {point_text(at_m)}" for at_m in shapes[0])
        rows = [row + "".join(f",{value:.6g}" for value in own) for row, own in zip(rows, real, strict=True)]
    return "\n".join([comment, header, *rows, ""])


class _Line(NamedTuple):
    """A response (frequency,) to one actuator, by its index, or to a force, by its place, at one place."""

    drive: complex
    position_m: complex
    frequency_hz: Array
    value: Complex

    def channel(self, top: float) -> Channel:
        """The response over s in units of `top`, rad/s, of both signs."""
        return _mirrored(2j * np.pi / top * self.frequency_hz.astype(np.complex128)), _mirrored(self.value)


def _split(measurements: Measurements, source: str) -> list[_Line]:
    """The response to each actuator, or force, at each place."""
    moving = ~np.isnan(measurements.frequency_hz)
    if measurements.kind is not Kind.RESPONSE or (moving.sum(axis=1) > 1).any():
        raise MeasurementError(f"{source}: modes are picked from complex responses, one actuator moving in each")
    if (~np.isnan(measurements.finger_m)).any():
        raise MeasurementError(f"{source}: has a finger on it; modes are those of the untouched surface")
    places = np.unique(measurements.position_m)
    if measurements.sensor_mass_kg.any() and len(places) > 1:
        raise MeasurementError(f"{source}: sensor mass: it moves the modes; keep one place, or fit the responses")
    rows, which = np.arange(len(moving)), moving.argmax(axis=1)
    force_m, hz = measurements.force_m, measurements.frequency_hz[rows, which]
    value = measurements.acceleration / (1.0 if force_m is not None else measurements.amplitude[rows, which])
    drive = which if force_m is None else force_m
    of, of_row = np.unique(np.column_stack([drive, measurements.position_m]), axis=0, return_inverse=True)
    rows_of = [of_row.ravel() == n for n in range(len(of))]
    found = [_Line(of[n, 0], of[n, 1], hz[rows], value[rows]) for n, rows in enumerate(rows_of)]
    fewest = min(len(np.unique(line.frequency_hz)) for line in found)
    if fewest < _FEWEST_LINES:
        raise MeasurementError(f"{source}: a place has {fewest} frequencies; modes need {_FEWEST_LINES} or more")
    return found


def _mirrored(value: Complex) -> Complex:
    return np.stack([value, value.conj()], axis=1, dtype=np.complex128).ravel()


def _without(fold: int, s: Complex, value: Complex) -> Channel:
    kept = np.arange(len(s)) // 2 % _FOLDS != fold  # both signs of a line are beside each other
    return s[kept], value[kept]


def _search(channels: Sequence[Channel], low: float) -> Complex:
    """The poles of the model that the criterion of Schwarz prefers."""
    lines = sum(len(s) for s, _ in channels)
    best, poles, worse = np.inf, np.zeros(0, dtype=np.complex128), 0
    for pairs in range(1, min(_MOST_PAIRS, min(len(s) for s, _ in channels) // 4) + 1):
        start = np.linspace(low, 1.0, pairs)
        found = _relocate(channels, np.concatenate([start * (-0.01 + 1j), start * (-0.01 - 1j)]))
        misfit = max(_misfit(channels, found), _LEAST_MISFIT**2)
        score = lines * np.log(misfit) + 2 * pairs * (1 + len(channels)) * np.log(lines)
        worse = 0 if score < best else worse + 1
        if score < best:
            best, poles = score, found
        if worse >= _PATIENCE:
            break
    return poles


def _weighted(s: Complex, value: Complex, poles: Complex) -> tuple[Complex, Complex, Complex]:
    """The terms of the sum, those of S and the response, each in units of the response."""
    weight = 1 / np.maximum(abs(value), _FLOOR * abs(value).max())
    basis = weight[:, None] / (s[:, None] - poles)
    terms = np.hstack([basis, weight[:, None] * s[:, None] ** _POLYNOMIAL])
    return terms, -value[:, None] * basis, weight * value


def _relocate(channels: Sequence[Channel], poles: Complex) -> Complex:
    """Common poles after some rounds of vector fitting, all of them stable."""
    for _ in range(_ROUNDS):
        rows = []
        for s, value in channels:
            terms, common, response = _weighted(s, value, poles)
            triangle = np.asarray(np.linalg.qr(np.hstack([terms, common, response[:, None]]), mode="r"))
            rows.append(triangle[terms.shape[1] :, terms.shape[1] :])  # the residues of this response are eliminated
        every = np.vstack(rows)
        share = np.linalg.lstsq(every[:, :-1], every[:, -1], rcond=None)[0]
        moved = np.linalg.eigvals(np.diag(poles) - share)
        poles = -abs(moved.real) + 1j * moved.imag
    return poles


def _misfit(channels: Sequence[Channel], poles: Complex) -> float:
    """Mean square of the relative misfit with these poles."""
    squares = []
    for s, value in channels:
        terms, _, response = _weighted(s, value, poles)
        squares.append(abs(terms @ np.linalg.lstsq(terms, response, rcond=None)[0] - response) ** 2)
    return float(np.concatenate(squares).mean())
