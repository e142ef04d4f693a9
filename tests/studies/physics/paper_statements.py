"""Statements of the paper that a model can be checked against, each with the margin by which a device keeps it.

The paper (IEEE Access 2023, 10.1109/ACCESS.2023.3247606) states in words what its figures show. Each statement is a
predicate here. Its margin is in dB: 0 or more keeps the statement, and 3 dB more would still keep it if every
amplitude that it compares were 3 dB worse. What the paper leaves open is a `Reading`: which actuator drove alone,
which one took the first frequency of a pair, and from which end positions and zones are counted.

Four words of the paper have no number. Here a node is at most a quarter of the greatest acceleration along the bar in
the same drive, a significant vibration is at least a third of it, "around" is within half an inch, and "significantly
greater" is 2 dB or more. The optimum of Figure 8 counts as found when some local maximum of equation (11) lies within
0.005 of the published 0.8626. The solver of the paper is a local one, so any local maximum may be the published one.

python -m tests.studies.physics.paper_statements [DEVICE] prints them for reference-a, counted from either end.
"""

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from base.arrays import Array, Integers, Mask
from engine.device import Device
from precompute.model.assembly import assemble
from precompute.model.gram import compute_gram
from precompute.model.response import solve_response
from tactable.shipped import find_device
from tests.studies.options import read_options

DampingOf = Literal["bar", "assembly"]
DAMPING_OF: tuple[DampingOf, ...] = ("bar", "assembly")

NODE, SIGNIFICANT, GREATER_DB = 1 / 4, 1 / 3, 2.0
AROUND_M, INCH_M = 0.0127, 0.0254
OPTIMUM, OPTIMUM_TOLERANCE = 0.8626, 0.005
REACH_M_PER_S2 = 1.5 * 9.80665
PLACES = 129
SINGLE_HZ, PARTNER_HZ = (140.0, 200.0, 230.0), (130.0, 200.0, 230.0)
FIRST_HZ, DEMO_HZ = 150.0, (60.0, 90.0)
_TONES = np.array([130.0, 140.0, 150.0, 200.0, 230.0])
_BEST_DB, _WORST_DB = 20.0, -40.0
"""Margins are cut here: an exact zero would be infinitely good."""


@dataclass(frozen=True)
class Reading:
    """What the paper leaves open and no dimension decides."""

    alone: int
    """Index of the actuator that drove alone in Figure 6."""
    right_first: bool
    """The right actuator took the first frequency of every pair."""
    from_right: bool
    """Positions and zones are counted from the right end."""

    def __str__(self) -> str:
        alone = ("left", "right")[self.alone]
        first, end = ("right" if self.right_first else "left"), ("right" if self.from_right else "left")
        return f"{alone} actuator alone in Figure 6, {first} one takes the first frequency, counted from the {end} end"


@dataclass(frozen=True)
class Solved:
    """A device solved once for all readings. Accelerations in m/s^2 at full scale.

    tones (tone, actuator, place) at `_TONES`; sweep (frequency, actuator, place) and sweep_share (frequency, zone,
    actuator), the localized factors of one actuator alone; demo (tone, actuator, place) and demo_energy (tone, zone,
    actuator), in one arbitrary unit, of Figure 3.
    """

    place_m: Array
    zone_of: Integers
    tones: Array
    sweep: Array
    sweep_share: Array
    demo: Array
    demo_energy: Array


def with_damping_of(device: Device, damping_of: DampingOf) -> Device:
    """The device with one of the two readings of equation (2)."""
    return replace(device, surface=replace(device.bar, damping_of=damping_of))


def demo_device(device: Device) -> Device:
    """The device with the values of Figure 3: no material damping, other actuators."""
    actuators = tuple(
        replace(actuator, stiffness_n_per_m=20e3, damping_n_s_per_m=0.0265, full_scale_m=0.42e-6)
        for actuator in device.actuators
    )
    return replace(
        device, surface=replace(device.bar, mass_damping_per_s=0.0, stiffness_damping_s=0.0), actuators=actuators
    )


def solve(device: Device, frequency_hz: Array) -> Solved:
    """Solve what the statements speak of; frequency_hz (frequency,), rising, is where optimum and reach are sought."""
    plant, demo = assemble(device), assemble(demo_device(device))
    place_m = np.linspace(0, device.bar.length_m, PLACES)
    stops_m = np.array([zone.stop_m for zone in device.zones])
    both = solve_response(plant, np.concatenate([_TONES, frequency_hz]))
    acceleration = np.abs(both.acceleration(place_m))
    energy = np.einsum("fzaa->fza", compute_gram(both)[0]).real[len(_TONES) :]
    shown = solve_response(demo, np.array(DEMO_HZ))
    return Solved(
        place_m=place_m,
        zone_of=np.minimum(np.searchsorted(stops_m, place_m, side="left"), len(stops_m) - 1),
        tones=acceleration[: len(_TONES)],
        sweep=acceleration[len(_TONES) :],
        sweep_share=energy / energy.sum(axis=1, keepdims=True),
        demo=np.abs(shown.acceleration(place_m)),
        demo_energy=np.einsum("fzaa->fza", compute_gram(shown)[0]).real,
    )


@dataclass(frozen=True)
class Figures:
    """The figures of the paper as a reading of a solved device gives them; places and zones counted as it counts."""

    place_m: Array
    single: dict[float, Array]
    """Figure 6, acceleration (place,) by frequency."""
    dual: dict[float, Array]
    """Figure 7, acceleration (place,) by the second frequency."""
    reach: Array
    """Greatest acceleration (place,) of any two frequencies, equation (8)."""
    demo_share: Array
    demo_peak: Array
    optimum_share: Array
    """Localized factors (candidate, zone) of the local maxima of equation (11) for I + III + V."""
    optimum_peak: Array
    """Peak accelerations (candidate, zone) there."""

    def around(self, place_in: float) -> Mask:
        """Shape (place,): whether a place is around this many inches."""
        near: Mask = np.abs(self.place_m - place_in * INCH_M) <= AROUND_M
        return near


def figures_of(solved: Solved, reading: Reading) -> Figures:
    """What a reading makes of a solved device."""
    first, second = (1, 0) if reading.right_first else (0, 1)
    zones = solved.demo_energy.shape[1]
    turn = slice(None, None, -1) if reading.from_right else slice(None)

    def tone(frequency_hz: float, actuator: int) -> Array:
        return solved.tones[int(np.searchsorted(_TONES, frequency_hz)), actuator, turn]

    def peaks(field: Array) -> Array:
        return np.array([field[..., solved.zone_of == zone].max(axis=-1) for zone in range(zones)][turn]).T

    energy = solved.demo_energy[0, :, first] + solved.demo_energy[1, :, second]
    share, peak = list[Array](), list[Array]()
    for actuator in range(solved.sweep.shape[1]):
        wanted = solved.sweep_share[:, ::2, actuator].sum(axis=1)
        padded = np.concatenate([[-1.0], wanted, [-1.0]])
        at = np.flatnonzero((wanted >= padded[:-2]) & (wanted >= padded[2:]))
        share.append(solved.sweep_share[at, :, actuator][:, turn])
        peak.append(peaks(solved.sweep[at, actuator]))
    return Figures(
        place_m=solved.place_m,
        single={hz: tone(hz, reading.alone) for hz in SINGLE_HZ},
        dual={hz: tone(FIRST_HZ, first) + tone(hz, second) for hz in PARTNER_HZ},
        reach=solved.sweep.max(axis=0).sum(axis=0)[turn],
        demo_share=(energy / energy.sum())[turn],
        demo_peak=peaks(solved.demo[0, first] + solved.demo[1, second]),
        optimum_share=np.concatenate(share),
        optimum_peak=np.concatenate(peak),
    )


def _decibels(ratio: float) -> float:
    return float(np.clip(20 * np.log10(max(ratio, 1e-9)), _WORST_DB, _BEST_DB))


def _beats(values: Array, best: int) -> float:
    """By how many dB `values[best]` is above the next; amplitudes."""
    return _decibels(values[best] / np.delete(values, best).max())


def _node(field: Array, near: Mask) -> tuple[int, float]:
    """Index of the least place near, and what it is of the greatest along the bar."""
    least = int(np.where(near, field, np.inf).argmin())
    return least, float(field[least] / field.max())


Checked = tuple[str, float]
"""What the device has, in words, and the margin in dB."""


def _is_node(field: Array, near: Mask) -> Checked:
    ratio = _node(field, near)[1]
    return f"{100 * ratio:.0f} % of the greatest", _decibels(NODE / ratio)


def _is_neutralized(node_of: Array, field: Array, near: Mask) -> Checked:
    ratio = float(field[_node(node_of, near)[0]] / field.max())
    return f"{100 * ratio:.0f} % of the greatest there", _decibels(ratio / SIGNIFICANT)


_NAMES = ("I", "II", "III", "IV", "V")


def _order(values: Array) -> str:
    return " > ".join(f"{_NAMES[zone]} {values[zone]:.3g}" for zone in np.argsort(-values))


def _same_order(figures: Figures) -> Checked:
    """Least over pairs of zones of how clearly both measures agree, or minus how clearly they disagree."""
    share, peak = 10 * np.log10(figures.demo_share), 20 * np.log10(figures.demo_peak)
    worst = np.inf
    for one, other in itertools.combinations(range(len(share)), 2):
        a, b = share[one] - share[other], peak[one] - peak[other]
        worst = min(worst, min(abs(a), abs(b)) * (1 if a * b > 0 else -1))
    return f"factor {_order(figures.demo_share)}; peak {_order(figures.demo_peak)}", float(worst)


def _stronger_at_six(figures: Figures) -> Checked:
    near = figures.around(6)
    ratio = figures.dual[230.0][near].mean() / figures.dual[130.0][near].mean()
    return f"{_decibels(ratio):+.1f} dB", _decibels(ratio) - GREATER_DB


def _two_beat_one(figures: Figures) -> Checked:
    one = np.mean([field.mean() for field in figures.single.values()])
    two = np.mean([field.mean() for field in figures.dual.values()])
    return f"{_decibels(float(two / one)):+.1f} dB, mean along the bar", _decibels(float(two / one)) - GREATER_DB


def _reach(figures: Figures) -> Checked:
    least = float(figures.reach.min())
    return f"{least / 9.80665:.2f} g at the weakest place", _decibels(least / REACH_M_PER_S2)


def _optimum(figures: Figures) -> list[Checked]:
    """The three statements of Figure 8 at the local maximum that keeps most of them, then by the widest margin."""
    best: list[Checked] | None = None
    best_key = (-1, -np.inf)
    for share, peak in zip(figures.optimum_share, figures.optimum_peak, strict=True):
        total, wanted, other = float(share[::2].sum()), float(share[::2].min()), float(share[1::2].max())
        lower, upper = float(peak[::2].min()), float(peak[1::2].max())
        checked = [
            (f"{total:.4f}", _decibels(OPTIMUM_TOLERANCE / max(abs(total - OPTIMUM), 1e-9))),
            (f"least wanted {wanted:.3f}, greatest other {other:.3f}", _decibels(wanted / other) / 2 - GREATER_DB),
            (f"least wanted {lower:.1f}, greatest other {upper:.1f} m/s^2", _decibels(lower / upper) - GREATER_DB),
        ]
        key = (sum(margin >= 0 for _, margin in checked), min(margin for _, margin in checked))
        if key > best_key:
            best, best_key = checked, key
    assert best is not None
    return best


Predicate = Callable[[Figures], Checked]
STATEMENTS: list[tuple[str, str, Predicate]] = [
    ("3a", "zone V has the highest localized factor", lambda f: (_order(f.demo_share), _beats(f.demo_share, 4) / 2)),
    ("3b", "zone V has the highest peak acceleration", lambda f: (_order(f.demo_peak), _beats(f.demo_peak, 4))),
    (
        "3c",
        "zone III has the lowest localized factor",
        lambda f: (_order(f.demo_share), _beats(1 / f.demo_share, 2) / 2),
    ),
    ("3d", "zone III has the lowest peak acceleration", lambda f: (_order(f.demo_peak), _beats(1 / f.demo_peak, 2))),
    ("3e", "factor and peak acceleration put the zones in one order", _same_order),
    ("6a", "one actuator, 140 Hz: a node around 2 in", lambda f: _is_node(f.single[140.0], f.around(2))),
    ("6b", "200 Hz neutralizes it", lambda f: _is_neutralized(f.single[140.0], f.single[200.0], f.around(2))),
    ("6c", "230 Hz neutralizes it", lambda f: _is_neutralized(f.single[140.0], f.single[230.0], f.around(2))),
    ("6d", "one actuator, 230 Hz: a node around 4 in", lambda f: _is_node(f.single[230.0], f.around(4))),
    ("6e", "140 Hz neutralizes it", lambda f: _is_neutralized(f.single[230.0], f.single[140.0], f.around(4))),
    ("7a", "150 & 200 Hz: a node near 2 in", lambda f: _is_node(f.dual[200.0], f.around(2))),
    ("7b", "150 & 130 Hz neutralizes it", lambda f: _is_neutralized(f.dual[200.0], f.dual[130.0], f.around(2))),
    ("7c", "150 & 230 Hz neutralizes it", lambda f: _is_neutralized(f.dual[200.0], f.dual[230.0], f.around(2))),
    ("7d", "near 6 in 150 & 230 Hz is stronger than 150 & 130 Hz", _stronger_at_six),
    ("7e", "two actuators are significantly stronger than one", _two_beat_one),
    ("7f", "more than 1.5 g is reached at every place", _reach),
    ("8a", "the optimum for I + III + V is 0.8626", lambda f: _optimum(f)[0]),
    ("8b", "there I, III, V have significantly higher factors than II, IV", lambda f: _optimum(f)[1]),
    ("8c", "there I, III, V have significantly higher peaks than II, IV", lambda f: _optimum(f)[2]),
]


def check(figures: Figures) -> list[Checked]:
    """Every statement of STATEMENTS, in order."""
    return [predicate(figures) for _, _, predicate in STATEMENTS]


def main() -> None:
    """Print the statements for reference-a or the device named, counted from either end."""
    device = find_device(read_options(__doc__, device=("reference-a",)).device)
    for damping_of in DAMPING_OF:
        solved = solve(with_damping_of(device, damping_of), np.linspace(60, 300, 961))
        for reading in (Reading(1, False, False), Reading(1, False, True)):
            checked = check(figures_of(solved, reading))
            kept = sum(margin >= 0 for _, margin in checked)
            print(f"\nequation (2) of the {damping_of}, {reading}: {kept} of {len(checked)}")
            for (name, sentence, _), (value, margin) in zip(STATEMENTS, checked, strict=True):
                print(f"{name} {'kept' if margin >= 0 else 'FAILS':5s} {margin:+6.1f} dB  {sentence}: {value}")


if __name__ == "__main__":
    main()
