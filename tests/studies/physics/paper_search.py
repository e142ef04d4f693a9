"""Search for unpublished values of the paper's bar that keep all of its statements at once.

The paper gives material, actuators and damping, and leaves out length, width, thickness, the masses of the bolts, the
edges of the zones and the mesh; which actuator drove alone, which took the first frequency, and from which end it
counts; and whether M and K of equation (2) are the bar's own or the assembled ones. Each combination of the discrete
choices is a search of its own over the continuous values: a Latin hypercube first, then differential evolution from
its best points, the most promising combinations for longer. A set of values is better when it keeps more statements
(tests.studies.physics.paper_statements), then when its worst margin is wider.

    python -m tests.studies.physics.paper_search [--seed S] [--sets N]

evaluates N sets of values, 300 000 by default, which takes about 40 minutes of one processor. The same seed and number
give the same result on every machine; a budget of time would not.
"""

import itertools
from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import Bounds, OptimizeResult, differential_evolution
from scipy.stats import qmc

from base.arrays import Array, Integers, Mask
from engine.device import Device, Zone
from tactable.shipped import find_device
from tests.studies.options import read_options
from tests.studies.physics.paper_statements import (
    DAMPING_OF,
    READINGS,
    STATEMENTS,
    DampingOf,
    check,
    figures_of,
    margins,
    solve,
    with_damping_of,
)

BOUNDS = {
    "length, mm": (170.0, 420.0),
    "width, mm": (6.0, 60.0),
    "thickness, mm": (0.4, 4.0),
    "left bolt, g": (0.05, 40.0),
    "right bolt, g": (0.05, 40.0),
    "largest element, mm": (8.0, 60.0),
}
"""Searched evenly in the logarithm. The bar is at least long enough to have a place at 6 in."""
WIDEST_ZONE = 2.5
"""Where zones are not equal, relative widths lie between 1 and this."""
_GRID_HZ, _LAST_HZ, _FINE_HZ = (np.linspace(60, 300, count) for count in (241, 481, 961))
"""Where optimum and reach are sought: at first, in the last round, and for the report."""
_SAMPLES, _POPULATION = 2000, 36
_ROUNDS = (32, 10, 4, 3)
"""Choices that are searched on in each round; rounds have equal shares. The last round has the finer grid."""


@dataclass(frozen=True)
class Choice:
    """One combination of the discrete choices."""

    damping_of: DampingOf
    equal_zones: bool
    reading: int

    def __str__(self) -> str:
        zones = ("free", "equal")[self.equal_zones]
        return f"equation (2) of the {self.damping_of}, {zones} zones, {READINGS[self.reading]}"


CHOICES = [Choice(*choice) for choice in itertools.product(DAMPING_OF, (True, False), range(len(READINGS)))]


def device_of(x: Array, nominal: Device) -> Device:
    """The device of a point in the unit cube: values of BOUNDS, then five relative widths of zones unless equal."""
    low, high = np.log(np.array(list(BOUNDS.values()))).T
    length_mm, width_mm, thickness_mm, left_g, right_g, element_mm = np.exp(low + x[: len(low)] * (high - low))
    length_m = 1e-3 * length_mm
    widths = WIDEST_ZONE ** (x[len(low) :] if len(x) > len(low) else np.zeros(5))
    edges_m = length_m * np.concatenate([[0.0], np.cumsum(widths) / widths.sum()])
    edges_m[-1] = length_m
    bar = replace(
        nominal.bar,
        length_m=length_m,
        width_m=1e-3 * width_mm,
        thickness_m=1e-3 * thickness_mm,
        largest_element_m=1e-3 * element_mm,
    )
    actuators = tuple(
        replace(actuator, position_m=place * length_m, mass_kg=1e-3 * mass_g)
        for actuator, place, mass_g in zip(nominal.actuators, (0.16, 0.977), (left_g, right_g), strict=True)
    )
    zones = tuple(
        Zone(zone.name, start, stop)
        for zone, (start, stop) in zip(nominal.zones, itertools.pairwise(edges_m), strict=True)
    )
    return replace(nominal, surface=bar, actuators=actuators, zones=zones)


def score(margin: Array) -> float:
    """Number of statements kept, then how near the others are; where all are kept, the worst margin."""
    failed = margin[margin < 0]
    if len(failed) == 0:
        return len(margin) + float(margin.min()) / 100
    return len(margin) - len(failed) + 0.9 * float(np.mean(1 / (1 - failed / 3)))


@dataclass
class Archive:
    """What all evaluations have shown, whatever they were made for."""

    together: Mask = field(default_factory=lambda: np.eye(len(STATEMENTS), dtype=bool) & False)
    """(statement, statement): some set kept both."""
    most_with: Integers = field(default_factory=lambda: np.zeros(len(STATEMENTS), dtype=np.int64))
    """(statement,): the most statements that a set that keeps this one keeps."""
    best: dict[Choice, tuple[float, Array]] = field(default_factory=dict)
    evaluations: int = 0

    def note(self, choice: Choice, x: Array, margin: Array) -> float:
        """Take an evaluation in; its score."""
        kept = margin >= 0
        self.together |= kept[:, None] & kept
        self.most_with[kept] = np.maximum(self.most_with[kept], kept.sum())
        value = score(margin)
        if choice not in self.best or value > self.best[choice][0]:
            self.best[choice] = (value, x.copy())
        return value


class Search:
    """Searches that share an archive and a budget of evaluations."""

    def __init__(self, seed: int, sets: int) -> None:
        self.archive = Archive()
        self._nominal = find_device("reference-a")
        self._random = np.random.default_rng(seed)
        self._sets = sets
        self._grid_hz = _GRID_HZ
        self._starts: dict[Choice, list[tuple[float, Array]]] = {choice: [] for choice in CHOICES}

    @property
    def left(self) -> int:
        """Evaluations that are left."""
        return self._sets - self.archive.evaluations

    def _margins(self, x: Array, damping_of: DampingOf) -> Array:
        self.archive.evaluations += 1
        return margins(solve(with_damping_of(device_of(x, self._nominal), damping_of), self._grid_hz))

    def sample(self) -> None:
        """A Latin hypercube for each kind of damping and zones, scored for all readings at once."""
        for damping_of, equal_zones in itertools.product(DAMPING_OF, (True, False)):
            cube = qmc.LatinHypercube(len(BOUNDS) + (0 if equal_zones else 5), seed=self._random)
            for x in cube.random(min(_SAMPLES, self._sets // 40)):
                for reading, margin in enumerate(self._margins(x, damping_of)):
                    choice = Choice(damping_of, equal_zones, reading)
                    self._starts[choice].append((self.archive.note(choice, x, margin), x))
        for starts in self._starts.values():
            starts.sort(key=lambda start: -start[0])

    def evolve(self, choice: Choice, sets: int, pair: tuple[int, int] | None = None) -> float:
        """Differential evolution of one choice; the best score, or the best worse margin of a pair of statements."""
        end = self.archive.evaluations + min(sets, self.left)
        size = len(BOUNDS) + (0 if choice.equal_zones else 5)
        best = -np.inf

        def is_over() -> bool:
            return self.archive.evaluations >= end or (pair is not None and best >= 0)

        def cost(x: Array) -> float:
            nonlocal best
            if is_over():
                return np.inf
            margin = self._margins(x, choice.damping_of)[choice.reading]
            value = self.archive.note(choice, x, margin)
            if pair is not None:
                value = float(margin[list(pair)].min())
            best = max(best, value)
            return -value

        def stop(intermediate_result: OptimizeResult) -> None:  # noqa: ARG001  # scipy looks at the name
            if is_over():
                raise StopIteration

        while not is_over():
            known = [x for _, x in self._starts[choice][: _POPULATION // 3]]
            if choice in self.archive.best:
                known.append(self.archive.best[choice][1])
            fresh = self._random.random((_POPULATION - len(known), size))
            differential_evolution(
                cost,
                Bounds(np.zeros(size), np.ones(size)),
                init=np.concatenate([known, fresh]),
                maxiter=10_000,
                mutation=(0.4, 0.9),
                recombination=0.8,
                tol=1e-4,
                polish=False,
                seed=self._random,
                callback=stop,
            )
        return best

    def run(self) -> None:
        """Sample, then give the choices that look best a larger share in each round."""
        self.sample()
        share = self.left // len(_ROUNDS)
        chosen: Iterable[Choice] = CHOICES
        for count in _ROUNDS:
            chosen = sorted(chosen, key=lambda choice: -self.archive.best[choice][0])[:count]
            if count == _ROUNDS[-1]:
                self._look_closer(chosen)
            for choice in chosen:
                found = self.evolve(choice, share // count)
                said(f"{found:7.3f}  {choice}; {self.left} sets left")

    def _look_closer(self, choices: Iterable[Choice]) -> None:
        """Go on with the finer grid: what these choices had found counts by it."""
        self._grid_hz = _LAST_HZ
        for choice in choices:
            _, x = self.archive.best.pop(choice)
            self.archive.note(choice, x, self._margins(x, choice.damping_of)[choice.reading])

    def exclude(self) -> list[tuple[int, int]]:
        """Pairs of statements that no set kept together, though each pair was then searched for by itself."""
        together = self.archive.together
        apart = [(i, j) for i, j in itertools.combinations(range(len(STATEMENTS)), 2) if not together[i, j]]
        for (i, j), choice in itertools.product(apart, CHOICES):
            if not together[i, j]:
                self._sets = self.archive.evaluations + _POPULATION * 20
                self.evolve(choice, _POPULATION * 20, pair=(i, j))
        return [(i, j) for i, j in apart if not together[i, j]]

    def finish(self, choice: Choice) -> tuple[Device, Array, list[tuple[str, float]]]:
        """The best device of a choice on the fine grid: device, margins, and every statement with its value."""
        device = with_damping_of(device_of(self.archive.best[choice][1], self._nominal), choice.damping_of)
        solved = solve(device, _FINE_HZ)
        margin = margins(solved)[choice.reading]
        return device, margin, check(figures_of(solved, READINGS[choice.reading]))


def said(line: str) -> None:
    """Print at once: the search takes long."""
    print(line, flush=True)


def describe(device: Device) -> dict[str, object]:
    """The values that were searched."""
    bar = device.bar
    return {
        "length_mm": float(1e3 * bar.length_m),
        "width_mm": float(1e3 * bar.width_m),
        "thickness_mm": float(1e3 * bar.thickness_m),
        "bolts_g": [float(1e3 * actuator.mass_kg) for actuator in device.actuators],
        "zone_edges_mm": [1e3 * zone.stop_m.real for zone in device.zones[:-1]],
        "largest_element_mm": float(1e3 * bar.largest_element_m),
    }


def main() -> None:
    """Search, and say what was found."""
    options = read_options(__doc__, seed=1, sets=300_000)
    search = Search(options.seed, options.sets)
    search.run()
    excluded = [(STATEMENTS[i][0], STATEMENTS[j][0]) for i, j in search.exclude()]
    archive, count = search.archive, len(STATEMENTS)
    best = sorted(archive.best, key=lambda choice: -archive.best[choice][0])
    most_with = {name: int(most) for (name, _, _), most in zip(STATEMENTS, archive.most_with, strict=True)}
    said(f"{archive.evaluations} sets, seed {options.seed}")
    said(f"pairs that no set kept together: {excluded or 'none'}")
    said("most kept by a set that keeps: " + ", ".join(f"{name} {most}" for name, most in most_with.items()))
    for choice in best:
        said(f"{archive.best[choice][0]:7.3f}  {choice}")
    for rank, choice in enumerate(best[:6]):
        device, margin, checked = search.finish(choice)
        kept = int((margin >= 0).sum())
        said(f"\n{kept} of {count} kept, worst margin {margin.min():+.2f} dB: {choice}\n{describe(device)}")
        failing = {name: round(float(m), 2) for (name, _, _), m in zip(STATEMENTS, margin, strict=True) if m < 0}
        said(f"failing, dB: {failing or 'none'}")
        if rank == 0:
            for (name, sentence, _), (value, _), m in zip(STATEMENTS, checked, margin, strict=True):
                said(f"{name} {'kept' if m >= 0 else 'FAILS':5s} {m:+6.1f} dB  {sentence}: {value}")


if __name__ == "__main__":
    main()
