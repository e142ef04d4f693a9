"""Drives that try to beat an entry on a DenseState: at random by the hundred thousand, and climbing from the best."""

import itertools
import warnings
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy.optimize
from numpy.typing import NDArray

from engine.device import Device
from tests.precompute.predict.dense_state import DenseState

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Index = NDArray[np.int64]

BEAT_HZ = 10.0
"""Tones closer than this beat: no drive has them."""
LEVEL_TOLERANCE = 10 ** (-1e-3 / 10)
"""A level within 0.001 dB of the wanted one is reached."""
_STEP_HZ = 0.5
_CLOSE_HZ = np.array([0.0, 0.01, 0.03, 0.1, 0.2, 0.4, 0.8, 1.3, 2.0, 3.0])
_REACH_HZ = 6.0
_CHUNK = 25000


@dataclass(frozen=True)
class Rival:
    """A drive: frequency_hz and complex amplitude (actuator,), fractions of the device's limit; ratio and level."""

    frequency_hz: Array
    amplitude: Complex
    ratio: float
    level: float


@dataclass
class Tries:
    """Many drives on a grid of frequencies: tone, place in the grid, amplitude (try, actuator), ratio, level (try,)."""

    frequency_hz: Array
    tone: Index
    place: Index
    amplitude: Complex
    ratio: Array = field(init=False)
    level: Array = field(init=False)


def partitions(actuators: int) -> list[tuple[int, ...]]:
    """Every way to share actuators among tones: the tone of each, numbered as they come; all on one tone first."""
    found: set[tuple[int, ...]] = {()}
    for _ in range(actuators):
        found = {(*tones, t) for tones in found for t in range(max(tones, default=-1) + 2)}
    return sorted(found)


def grid_for(device: Device, near_hz: Array, random: np.random.Generator) -> tuple[Array, Index]:
    """Frequencies over all bands and close to those of an entry, and the places of the close ones."""
    low, high = (edge([actuator.band_hz[i] for actuator in device.actuators]) for i, edge in enumerate((min, max)))
    even = np.arange(low, high, _STEP_HZ) + random.uniform(0, _STEP_HZ)
    close = np.unique(near_hz)[:, None] + np.concatenate([_CLOSE_HZ, -_CLOSE_HZ])
    edges = np.unique([actuator.band_hz for actuator in device.actuators])
    grid = np.unique(np.clip(np.concatenate([even, edges, close.ravel()]), low, high))
    away = abs(grid[:, None] - np.unique(near_hz)).min(axis=1)
    return grid, np.flatnonzero(away <= _CLOSE_HZ[-1])


def random_tries(
    device: Device, near_hz: Array, near_amplitude: Complex, count: int, random: np.random.Generator
) -> Tries:
    """Drives of every family, a third of the amplitudes close to the entry's, half of the tones close to its tones."""
    grid, close = grid_for(device, near_hz, random)
    actuators = len(device.actuators)
    families = np.array(partitions(actuators))
    tone = families[random.integers(len(families), size=count)]
    place = np.zeros((count, actuators), dtype=np.int64)
    beating = np.ones(count, dtype=bool)
    while beating.any():
        anywhere = random.integers(len(grid), size=(beating.sum(), actuators))
        there = random.choice(close, size=anywhere.shape)
        tones = np.where(random.uniform(size=anywhere.shape) < 0.5, anywhere, there)
        place[beating] = np.take_along_axis(tones, tone[beating], axis=1)
        beating = _beating(grid[place], tone)
    amplitude = _random_amplitudes(near_amplitude, count, random)
    bands = np.array([actuator.band_hz for actuator in device.actuators])
    amplitude[(grid[place] < bands[:, 0]) | (grid[place] > bands[:, 1])] = 0
    some = abs(amplitude).max(axis=1) > 0
    amplitude = amplitude[some] / abs(amplitude[some]).max(axis=1, keepdims=True)
    return Tries(grid, tone[some], place[some], amplitude)


def _beating(hz: Array, tone: Index) -> NDArray[np.bool_]:
    apart = abs(hz[:, :, None] - hz[:, None, :]) >= BEAT_HZ
    beats: NDArray[np.bool_] = (~apart & (tone[:, :, None] != tone[:, None, :])).any(axis=(1, 2))
    return beats


def _random_amplitudes(near: Complex, count: int, random: np.random.Generator) -> Complex:
    """A third over two decades, a third even over all directions, a third close to `near`; some actuators silent."""
    shape = (count, len(near))
    phase = np.exp(2j * np.pi * random.uniform(size=shape))
    normal = random.normal(size=shape) + 1j * random.normal(size=shape)
    kinds = [
        10 ** random.uniform(-2, 0, shape) * phase,
        normal,
        near + 10 ** random.uniform(-3, 0, (count, 1)) * normal,
    ]
    out: Complex = np.choose(random.integers(3, size=(count, 1)), kinds)
    silent = random.uniform(size=shape) < 0.1
    silent[np.arange(count), random.integers(len(near), size=count)] = False
    out[silent] = 0
    return out


def judge_tries(state: DenseState, tries: Tries) -> None:
    """Ratio and level of every try."""
    forms = np.stack([state.forms(float(hz))[0] for hz in tries.frequency_hz])
    ratios, levels = [], []
    for start in range(0, len(tries.tone), _CHUNK):
        part = slice(start, start + _CHUNK)
        ratio, level = state.judge(_powers(forms, tries.tone[part], tries.place[part], tries.amplitude[part]))
        ratios.append(ratio)
        levels.append(level)
    tries.ratio, tries.level = np.concatenate(ratios), np.concatenate(levels)


def _powers(forms: Complex, tone: Index, place: Index, amplitude: Complex) -> Array:
    """Shape (try, form) from forms (frequency, form, actuator, actuator); different tones do not interfere."""
    out = np.zeros((len(tone), forms.shape[1]))
    for a, b in itertools.combinations_with_replacement(range(tone.shape[1]), 2):
        product = amplitude[:, a].conj() * amplitude[:, b] * (tone[:, a] == tone[:, b])
        out += (1 if a == b else 2) * (product[:, None] * forms[place[:, a], :, a, b]).real
    return out


def best_starts(tries: Tries, wanted: float, count: int) -> list[int]:
    """The best tries of every family, half of them coherent; those that reach the level first, apart in frequency."""
    missing = np.maximum(np.log(wanted) - np.log(tries.level), 0.0) if wanted else 0.0
    score = np.log(tries.ratio) - 50 * missing
    families = partitions(tries.tone.shape[1])
    shares = [count] if len(families) == 1 else [count - count // 2] + [count // 2] * (len(families) - 1)
    chosen: list[int] = []
    for family, share in zip(families, shares, strict=True):
        members = np.flatnonzero((tries.tone == family).all(axis=1))
        limit = -(-share // max(len(families) - 1, 1)) if max(family) else share
        taken: list[int] = []
        for k in members[np.argsort(-score[members])]:
            here = tries.frequency_hz[tries.place[k]]
            if all(abs(here - tries.frequency_hz[tries.place[other]]).max() > 1.0 for other in taken):
                taken.append(int(k))
            if len(taken) == limit:
                break
        chosen += taken
    return chosen[:count]


def climb(state: DenseState, device: Device, tries: Tries, start: int, wanted: float) -> Rival:
    """SLSQP from one try over frequencies, amplitudes and phases together; slopes are exact."""
    tone, amplitude = tries.tone[start], tries.amplitude[start]
    hz = np.array([tries.frequency_hz[tries.place[start]][tone == t][0] for t in range(tone.max() + 1)])
    task = _Climb(state, tone, wanted)
    first = np.concatenate([hz, amplitude.real, amplitude.imag])
    powers = task.powers(first)[0]
    below = 0.0 if state.loudest else float(np.log(powers[state.denominators].max()))
    above = float(np.log(powers[state.numerators].min()))
    low, high = _bounds(device, hz, tone)
    held = 0.0 if state.loudest else np.inf  # nothing below: d stays 0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # SLSQP clips what rounding puts outside its bounds
        found = scipy.optimize.minimize(
            task.objective,
            np.append(first, [above, below]),
            jac=task.objective_slope,
            method="SLSQP",
            bounds=scipy.optimize.Bounds(np.append(low, [-np.inf, -held]), np.append(high, [np.inf, held])),
            constraints=task.as_inequality,
            options={"maxiter": 60, "ftol": 1e-7},
        ).x
    return rival(state, *task.drive(found if np.isfinite(found).all() else first))


def _bounds(device: Device, hz: Array, tone: Index) -> tuple[Array, Array]:
    """Of frequencies, within _REACH_HZ and the bands of who plays them, and of amplitudes: 0 for who is out of band."""
    bands = np.array([actuator.band_hz for actuator in device.actuators])
    usable = (bands[:, 0] <= hz[tone]) & (hz[tone] <= bands[:, 1])
    low, high = hz - _REACH_HZ, hz + _REACH_HZ
    for actuator in np.flatnonzero(usable):
        t = tone[actuator]
        low[t], high[t] = max(low[t], bands[actuator, 0]), min(high[t], bands[actuator, 1])
    unheard = [t for t in range(len(hz)) if not usable[tone == t].any()]
    low[unheard] = high[unheard] = hz[unheard]
    most = 2.0 * np.tile(usable, 2)
    return np.append(low, -most), np.append(high, most)


def rival(state: DenseState, frequency_hz: Array, amplitude: Complex) -> Rival:
    """The drive at full amplitude, with its ratio and level; nothing where its tones beat."""
    amplitude = amplitude / abs(amplitude).max()
    ratio, level = state.judge(state.powers(frequency_hz, amplitude))
    played = np.unique(frequency_hz[amplitude != 0])
    beats = len(played) > 1 and np.diff(played).min() < BEAT_HZ - 1e-3
    return Rival(frequency_hz, amplitude, 0.0 if beats else float(ratio), 0.0 if beats else float(level))


class _Climb:
    """The problem in SLSQP's form, x = tones' frequencies, real and imaginary amplitudes, n and d.

    maximise n - d: log N_i >= n, log D_j <= d, log P_f >= log wanted, |a_l| <= 1, tones BEAT_HZ apart.
    """

    def __init__(self, state: DenseState, tone: Index, wanted: float) -> None:
        self.state, self.tone, self.log_wanted = state, tone, np.log(wanted) if wanted else -np.inf
        self.tones, self.count = int(tone.max()) + 1, len(tone)
        self.pairs = list(itertools.combinations(range(self.tones), 2))
        self._at: tuple[bytes, tuple[Array, Array]] | None = None

    def drive(self, x: Array) -> tuple[Array, Complex]:
        """Frequency and amplitude, each (actuator,)."""
        real, imaginary = np.split(x[self.tones : self.tones + 2 * self.count], 2)
        return x[: self.tones][self.tone], real + 1j * imaginary

    def powers(self, x: Array) -> tuple[Array, Array]:
        """Powers (form,) and their slopes (form, variable) over frequencies, real and imaginary amplitudes."""
        key = x[: self.tones + 2 * self.count].tobytes()
        if self._at is None or self._at[0] != key:
            self._at = key, self._compute_powers(x)
        return self._at[1]

    def _compute_powers(self, x: Array) -> tuple[Array, Array]:
        _, amplitude = self.drive(x)
        forms = [self.state._compute_forms(float(hz)) for hz in x[: self.tones]]
        power = np.full(forms[0].shape[1], 1e-300)
        slope = np.zeros((len(power), self.tones + 2 * self.count))
        for t, form in enumerate(forms):
            a = np.where(self.tone == t, amplitude, 0)
            turned = form @ a
            both = (turned @ a.conj()).real
            power += both[0]
            slope[:, t] = both[1]
            mine = np.flatnonzero(self.tone == t)
            slope[:, self.tones + mine] = 2 * turned[0][:, mine].real
            slope[:, self.tones + self.count + mine] = 2 * turned[0][:, mine].imag
        return power, slope

    @property
    def as_inequality(self) -> Any:
        """The constraints as minimize takes them."""
        return {"type": "ineq", "fun": self.constraints, "jac": self.constraint_slopes}

    def objective(self, x: Array) -> float:
        return float(x[-1] - x[-2])

    def objective_slope(self, x: Array) -> Array:
        out = np.zeros(len(x))
        out[-2:] = -1.0, 1.0
        return out

    def constraints(self, x: Array) -> Array:
        logs = np.log(np.maximum(self.powers(x)[0], 1e-300))
        _, amplitude = self.drive(x)
        apart = [self._side(x, s, t) * (x[s] - x[t]) - BEAT_HZ for s, t in self.pairs]
        parts = [logs[self.state.numerators] - x[-2], np.asarray(1 - abs(amplitude) ** 2), np.array(apart)]
        if not self.state.loudest:
            parts += [x[-1] - logs[self.state.denominators], logs[self.state.levels] - self.log_wanted]
        return np.concatenate(parts)

    def constraint_slopes(self, x: Array) -> Array:
        power, slope = self.powers(x)
        logs = np.pad(slope / np.maximum(power, 1e-300)[:, None], ((0, 0), (0, 2)))
        above, below = logs[self.state.numerators].copy(), -logs[self.state.denominators]
        above[:, -2], below[:, -1] = -1.0, 1.0
        _, amplitude = self.drive(x)
        limits = np.zeros((self.count, len(x)))
        limits[:, self.tones : self.tones + self.count] = np.diag(-2 * amplitude.real)
        limits[:, self.tones + self.count : -2] = np.diag(-2 * amplitude.imag)
        apart = np.zeros((len(self.pairs), len(x)))
        for row, (s, t) in zip(apart, self.pairs, strict=True):
            row[s], row[t] = self._side(x, s, t), -self._side(x, s, t)
        parts = [above, limits, apart]
        if not self.state.loudest:
            parts += [below, logs[self.state.levels]]
        return np.concatenate(parts)

    def _side(self, x: Array, s: int, t: int) -> float:
        return 1.0 if x[s] > x[t] else -1.0
