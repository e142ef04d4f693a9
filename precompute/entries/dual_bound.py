"""Upper bound on the objective by Lagrangian duality, tightened by column generation.

The problem is to maximise min_i N_i / max_j D_j over drives of one or several tones whose level is reached. Tones of
different frequencies do not interfere: the forms of a drive are sums over its tones. So the forms that drives of all
families reach lie in the convex cone of the forms of single tones, and the bound is the optimum over that cone.

Weights n_i, d_j >= 0 on the forms, and p_f, w_l >= 0 on levels and amplitudes, prove a bound: at each frequency no
drive exceeds the greatest eigenvalue of (sum n_i N_i + sum p_f P_f - diag w) a = lambda (sum d_j D_j) a, and so none
exceeds its maximum over frequency times sum d / sum n. Invariant: the bound holds for any weights whose w_l add up to
the wanted power times the sum of the p_f; good weights only make it smaller. The first weights are those that the forms
have at the optimum that was found, which often closes the gap.

Where a gap is left, columns are generated. A linear program mixes known drives of one frequency freely; its prices are
the next weights; the drives that these value most become new columns. Program and bound approach each other. The
frequencies of the mixture then show the search where drives of several tones may be better.

Bounds are computed at the search's frequencies. The maximum between them is taken from a parabola, so it may be passed
by the error of that parabola: at most 0.035 dB, in one of 362 searches of the shipped devices.
"""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import highspy
import numpy as np
from numpy.typing import NDArray

from precompute.entries.found_drive import FoundDrive, Weights, powers_of
from precompute.entries.objective import Problem

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

_TINY = 1e-30
_DEFINITE = 1e-12
_MIXED = 1e-6
_MOST_TONES = 3
_PRICED = 3


@dataclass(frozen=True)
class Tone:
    """One tone of a drive: the actuators that play it, with their amplitudes."""

    frequency_hz: float
    actuators: list[int]
    amplitude: Complex


class Columns:
    """Column generation: drives of one frequency each, whose powers a linear program mixes freely.

    maximise t: sum_c p_c N_i,c >= t, sum_c p_c D_j,c <= 1, sum_c p_c P_f,c >= wanted s, sum_c p_c |a_l,c|^2 <= s.
    """

    def __init__(self, problem: Problem, wanted: float) -> None:
        self._problem, self._muted = problem, problem.muted()
        self._frequency_hz: list[float] = []
        self._drives: list[Complex] = []
        self._mix = np.zeros(0)
        actuators, sizes = problem.in_band.shape[1], [len(stack) for stack in problem.stacks]
        self._ends = np.cumsum(sizes).tolist()
        numerator, denominator, level = (np.ones(size) for size in sizes)
        self.weights = Weights(numerator, denominator, 0 * level, np.zeros(actuators))
        """The prices of the last mixture."""
        # A level is counted in parts of what is wanted: all numbers are near 1.
        self._scale = np.repeat([1.0, 1.0, 1 / wanted if wanted > 0 else 1.0, 1.0], [*sizes, actuators])
        self._program = _empty_program(sizes, actuators, is_wanted=wanted > 0)

    def add(self, frequency_hz: float, amplitude: Complex) -> None:
        """Add a drive as a column; its amplitude may have any length."""
        hz, tone, grid_hz = (
            np.array([frequency_hz]),
            np.zeros(len(amplitude), dtype=np.int64),
            self._problem.frequency_hz,
        )
        powers = [powers_of(stack, grid_hz, hz, tone, amplitude) for stack in self._problem.stacks]
        scale = 1 / max(float(powers[1].max()), _TINY)
        self._frequency_hz.append(frequency_hz)
        self._drives.append(amplitude * np.sqrt(scale))
        column = np.concatenate([*powers, abs(amplitude) ** 2]) * scale * self._scale
        self._program.addCol(0.0, 0.0, np.inf, len(column), np.arange(len(column), dtype=np.int32), column)

    def add_single(self, k: int) -> None:
        """Add each actuator alone at the k-th frequency."""
        for actuator in np.flatnonzero(self._problem.in_band[k]):
            unit = np.eye(self._problem.in_band.shape[1], dtype=np.complex128)[actuator]
            self.add(float(self._problem.frequency_hz[k]), unit)

    def solve(self) -> tuple[Weights, float] | None:
        """Solve the program: the prices of the best mixture and its ratio, or None where no mixture is loud enough."""
        self._program.run()
        solution = self._program.getSolution()
        if self._program.getModelStatus() != highspy.HighsModelStatus.kOptimal or solution.col_value[0] <= 0:
            return None
        self._mix = np.array(solution.col_value)[2:]
        prices = abs(np.array(solution.row_dual)) * self._scale
        self.weights = Weights(*np.split(prices, self._ends))
        return self.weights, float(solution.col_value[0])

    def price(self, weights: Weights) -> float:
        """Add the drives that these weights value most as columns; return the bound that the weights prove."""
        eigenvalue, numerator, denominator = _eigenvalues(self._muted, weights)
        for k in peaks(eigenvalue)[:_PRICED]:
            _, amplitude = solve_eigen(numerator[k], denominator[k])
            amplitude[~self._problem.in_band[k]] = 0
            self.add(float(self._problem.frequency_hz[k]), amplitude)
        return _proved(self._problem, eigenvalue, weights)

    def mixtures(self) -> Iterator[list[Tone]]:
        """Every way to share the actuators among three or more mixed drives; the search tries all pairs itself."""
        used = [int(c) for c in np.argsort(-self._mix) if self._mix[c] > _MIXED][:_MOST_TONES]
        count = self._problem.in_band.shape[1]
        for tones in range(3, min(len(used), count) + 1):
            for columns in itertools.combinations(used, tones):
                for owner in itertools.product(range(tones), repeat=count):
                    if len(set(owner)) == tones:
                        yield [self._tone(c, [a for a in range(count) if owner[a] == t]) for t, c in enumerate(columns)]

    def _tone(self, column: int, actuators: list[int]) -> Tone:
        amplitude = self._drives[column][actuators] * np.sqrt(self._mix[column])
        return Tone(self._frequency_hz[column], actuators, amplitude)


def _empty_program(sizes: list[int], actuators: int, *, is_wanted: bool) -> highspy.Highs:
    """Rows N - t >= 0, D <= 1, P - s >= 0, |a|^2 - s <= 0; columns t, which is maximised, and s."""
    numerators, denominators, levels = sizes
    program = highspy.Highs()  # type: ignore[no-untyped-call]  # its __init__ has no annotations
    program.silent()
    # All programs of a process ask for one thread: HiGHS 1.16 refuses those that ask for another number than the first.
    program.setOptionValue("threads", 1)
    rows = [(0.0, np.inf)] * numerators + [(-np.inf, 1.0)] * denominators
    rows += [(0.0 if is_wanted else -np.inf, np.inf)] * levels + [(-np.inf, 0.0 if is_wanted else np.inf)] * actuators
    nothing = np.zeros(0, dtype=np.int32), np.zeros(0)
    for low, high in rows:
        program.addRow(low, high, 0, *nothing)
    by_t, by_s = np.arange(numerators), numerators + denominators + np.arange(levels + actuators)
    for cost, at in ((-1.0, by_t), (0.0, by_s)):
        program.addCol(cost, 0.0, np.inf, len(at), at.astype(np.int32), np.full(len(at), -1.0))
    return program


def compute_bound(problem: Problem, drive: FoundDrive, wanted: float) -> float:
    """The upper bound for drives above the level, from the weights that the forms have at `drive`."""
    level, actuator = drive.weights.level, drive.weights.actuator
    lifted = float(level.sum()) * wanted
    # Above the level sum_f w_f P_f >= wanted sum_f w_f max |a_l|^2 >= sum_l w_l |a_l|^2, if the w_l add up to that.
    if lifted > 0 and actuator.sum() > 0:
        actuator = actuator * (lifted / actuator.sum())
    else:
        level, actuator = 0 * level, 0 * actuator
    weights = Weights(drive.weights.numerator, drive.weights.denominator, level, actuator)
    return _proved(problem, _eigenvalues(problem.muted(), weights)[0], weights)


def block_directions(problem: Problem, weights: Weights, actuators: list[int]) -> Complex:
    """Shape (frequency, actuator): the drive of these actuators alone that the weights value most at each frequency."""
    _, numerator, denominator = _eigenvalues(problem.muted(), weights)
    pick = np.ix_(range(len(numerator)), actuators, actuators)
    out = np.zeros((len(numerator), problem.in_band.shape[1]), dtype=np.complex128)
    out[:, actuators] = solve_eigen(numerator[pick], denominator[pick])[1]
    out[~problem.in_band] = 0
    return out


def definite(D: Complex) -> Complex:
    """D (..., actuator, actuator) with 1e-12 of its trace on the diagonal: a form of few fingers may be singular."""
    trace = np.einsum("...aa->...", D).real
    return np.ascontiguousarray(D + (_DEFINITE * trace)[..., None, None] * np.eye(D.shape[-1]))


def solve_eigen(N: Complex, D: Complex) -> tuple[Array, Complex]:
    """The greatest lambda (...,) of N a = lambda D a for Hermitian N and definite D, and its a (..., actuator)."""
    inverse = np.linalg.inv(np.linalg.cholesky(D))
    turned = inverse.conj().swapaxes(-1, -2)
    value, vector = np.linalg.eigh(inverse @ N @ turned)
    return value[..., -1], (turned @ vector[..., -1:])[..., 0]


def greatest_eigenvalue(N: Complex, D: Complex) -> Array:
    """The greatest lambda (frequency,) of N a = lambda D a; forms (frequency, actuator, actuator) as above."""
    if N.shape[-1] == 2:  # closed form: half the trace plus the root of the discriminant of D^-1 N
        n, d = N.transpose(1, 2, 0), D.transpose(1, 2, 0)
        det_n, det_d = ((x[0, 0] * x[1, 1] - x[0, 1] * x[1, 0]).real for x in (n, d))
        crossed = n[0, 0] * d[1, 1] + n[1, 1] * d[0, 0] - n[0, 1] * d[1, 0] - n[1, 0] * d[0, 1]
        middle = 0.5 * crossed.real / det_d
        return np.asarray(middle + np.sqrt(np.maximum(middle * middle - det_n / det_d, 0.0)))
    # Turned into an ordinary eigenproblem by the Cholesky factor of D.
    inverse = np.linalg.inv(np.linalg.cholesky(D))
    return np.asarray(np.linalg.eigvalsh(inverse @ N @ inverse.conj().swapaxes(-1, -2))[..., -1])


def peaks(score: NDArray[np.floating]) -> list[int]:
    """Indices of the local maxima that are not negative, best first."""
    padded = np.concatenate([[-np.inf], score, [-np.inf]])
    top = (score >= 0) & (padded[1:-1] >= padded[:-2]) & (padded[1:-1] > padded[2:])
    indices = np.flatnonzero(top)
    return [int(k) for k in indices[np.argsort(-score[indices], kind="stable")]]


def _eigenvalues(problem: Problem, weights: Weights) -> tuple[Array, Complex, Complex]:
    """Greatest eigenvalue (frequency,) of the weighted forms, and these (frequency, actuator, actuator)."""
    numerator = np.tensordot(weights.numerator, problem.numerator, 1) + np.tensordot(weights.level, problem.level, 1)
    numerator = numerator - np.diag(weights.actuator)
    denominator = definite(np.tensordot(weights.denominator, problem.denominator, 1))
    out = greatest_eigenvalue(numerator, denominator)
    out[~problem.in_band.any(axis=1)] = -np.inf
    return out, numerator, denominator


def _proved(problem: Problem, eigenvalue: Array, weights: Weights) -> float:
    """The bound of these weights; no share passes 1, whatever weights prove."""
    bound = _top(eigenvalue) * float(weights.denominator.sum()) / max(float(weights.numerator.sum()), 1e-300)
    return min(bound, 1.0) if problem.is_share else bound


def _top(values: Array) -> float:
    """Maximum of the parabola through the greatest of `values` and its neighbours: what the grid may have missed."""
    k = int(values.argmax())
    if k in (0, len(values) - 1) or not np.isfinite(values[k - 1 : k + 2]).all():
        return float(values[k])
    left, middle, right = values[k - 1 : k + 2]
    curvature = left - 2 * middle + right
    return float(middle - (left - right) ** 2 / (8 * curvature)) if curvature < 0 else float(middle)
