"""Laws of the entries: no drive beats one, promises hold in models with the fingers assembled, hard cases answered."""

import os
from dataclasses import replace
from functools import cache
from itertools import pairwise
from math import comb

import numpy as np
import pytest
from numpy.typing import NDArray

from engine.device import Device, Zone
from engine.table import Entry
from engine.table.entry import scaled_to
from engine.touch import ZoneState, state_index
from precompute.entries.objective import OBJECTIVES
from precompute.entries.solver import MOST_TOUCHED_BEYOND, EntrySolver, solve_entries, tabulated_states
from precompute.model.assembly import assemble
from precompute.predict.rise_time import WITHIN
from precompute.sampling.fingers import SampledFingers, sample_fingers
from tests.precompute.dense_model import DenseModel, Figures
from tests.precompute.devices import mirrored, shipped, three_actuators, with_zones
from tests.precompute.entries.rivals import Rival, best_starts, climb, judge_tries, random_tries, rival
from tests.precompute.predict.dense_state import DenseState
from tests.quick import first_quick

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
States = tuple[ZoneState, ...]

STATES = int(os.environ.get("TACTABLE_RIVAL_STATES", "10"))
"""States that rivals are tried on: 50 in the long run, 5 minutes."""
TRIES, CLIMBS = 200_000, 20
TOLERANCE_DB = 0.05
PROMISE_DB = 0.0087  # 0.1 % of an acceleration
FEW = 4
FREE, QUIET, FELT = ZoneState


DEVICES = {
    "reference-a": shipped("reference-a"),
    "reference-d": shipped("reference-d"),
    "three actuators": three_actuators(),
}


def letters(states: States) -> str:
    return "".join("-QF"[state] for state in states)


def states_of(text: str) -> States:
    return tuple(ZoneState("-QF".index(letter)) for letter in text)


def random_cases(count: int) -> list[tuple[str, str, int]]:
    """Device, state and number of a level, the last of which is full scale."""
    random, cases = np.random.default_rng(20230247606), list[tuple[str, str, int]]()
    while len(cases) < count:
        name = list(DEVICES)[len(cases) % len(DEVICES)]
        device = DEVICES[name]
        states = tuple(ZoneState(kind) for kind in random.choice(3, size=len(device.zones), p=(0.4, 0.3, 0.3)))
        case = (name, letters(states), int(random.integers(len(device.levels_db) + 1)))
        if FELT in states and case not in cases:
            cases.append(case)
    return cases


CASES = random_cases(STATES)
any_case = pytest.mark.parametrize("case", CASES, ids=["{} {} level {}".format(*case) for case in CASES])
RIVALLED = [pytest.param(each, marks=() if each == CASES[3] else pytest.mark.long) for each in CASES]
"""Rivals are tried on one case at once, and on the others with the long tests."""


@cache
def solver_of(device: Device, objective: str = "contrast") -> EntrySolver:
    return EntrySolver(assemble(device), objective)


@cache
def entries_of(device: Device, states: str) -> list[Entry]:
    return solver_of(device).solve(states_of(states))


@cache
def bare_model(device: Device) -> DenseModel:
    return DenseModel(device)


@cache
def sampled_fingers_of(device: Device) -> SampledFingers:
    return sample_fingers(device)


@cache
def dense_state(device: Device, states: str, loudest: bool) -> DenseState:
    return DenseState(bare_model(device), sampled_fingers_of(device), states_of(states), loudest)


def drive_of(entry: Entry) -> tuple[Array, Complex]:
    return np.array(entry.frequencies_hz), np.array(entry.amplitudes) * np.exp(1j * np.array(entry.phases_rad))


def decibels(ratio: float) -> float:
    return float(10 * np.log10(ratio)) if ratio > 0 else -np.inf


def task_of(device: Device, entry: Entry) -> tuple[DenseState, float]:
    """The state as the entry should have seen it, and the power over threshold that is wanted at full amplitude."""
    loudest = not np.isfinite(entry.wanted_level_db) or not entry.achieved
    wanted = 0.0 if loudest else 10 ** (entry.wanted_level_db / 10) / device.limits.amplitude**2
    return dense_state(device, letters(entry.states), loudest), wanted


def rivals_of(device: Device, entry: Entry) -> list[Rival]:
    """The best of the random tries that is loud enough, then all that was climbed to and is."""
    state, wanted = task_of(device, entry)
    hz, amplitude = drive_of(entry)
    tries = random_tries(device, hz, amplitude / device.limits.amplitude, TRIES, np.random.default_rng(entry.index))
    judge_tries(state, tries)
    loud_enough = wanted * 10 ** (-1e-4)  # entries too may miss a level by 0.001 dB
    best = int(np.where(tries.level >= loud_enough, tries.ratio, 0.0).argmax())
    found = [rival(state, tries.frequency_hz[tries.place[best]], tries.amplitude[best])]
    found += [climb(state, device, tries, start, wanted) for start in best_starts(tries, wanted, CLIMBS)]
    return [one for one in found if one.level >= loud_enough]


@pytest.mark.parametrize("case", RIVALLED, ids=["{} {} level {}".format(*case) for case in CASES])
def test_no_drive_beats_an_entry(case: tuple[str, str, int]) -> None:
    """200 000 random drives of every family and 20 climbs over frequencies, amplitudes and phases."""
    name, states, level = case
    device = DEVICES[name]
    entry = entries_of(device, states)[level]
    state, _ = task_of(device, entry)
    mine = rival(state, *drive_of(entry))
    for other in rivals_of(device, entry):
        margin_db = decibels(mine.ratio / other.ratio)
        assert margin_db >= -TOLERANCE_DB, (margin_db, other)


@any_case
def test_an_entry_is_below_its_bound_by_its_gap(case: tuple[str, str, int]) -> None:
    name, states, level = case
    device = DEVICES[name]
    entry = entries_of(device, states)[level]
    state, _ = task_of(device, entry)
    value = rival(state, *drive_of(entry)).ratio * (device.limits.amplitude**2 if state.loudest else 1.0)
    bound_db = (
        decibels(entry.upper_bound) if "share" in entry.objective or "factor" in entry.objective else entry.upper_bound
    )
    assert bound_db >= decibels(value) - PROMISE_DB
    assert entry.optimality_gap_db == pytest.approx(bound_db - decibels(value), abs=PROMISE_DB)


@pytest.mark.parametrize(
    "name", ["reference-a", *(pytest.param(name, marks=pytest.mark.long) for name in ("reference-d", "reference-t"))]
)
def test_no_figure_that_is_shown_passes_its_bound(name: str) -> None:
    device = with_zones(shipped(name), 3)
    solver = solver_of(device)
    for states in tabulated_states(device):
        for entry in solver.solve(states):
            shown_db = {
                "contrast": entry.expected_contrast_db,
                "localized factor": decibels(entry.localized_factor),
                "level": entry.level_db,
            }[entry.objective]
            assert shown_db is not None
            bound_db = entry.upper_bound if entry.objective != "localized factor" else decibels(entry.upper_bound)
            assert bound_db >= shown_db - 0.01, letters(states)
            assert bound_db - entry.optimality_gap_db == pytest.approx(shown_db, abs=0.01)


@pytest.mark.parametrize(
    ("device", "objective", "states", "level"),
    [(shipped("reference-d"), "contrast", "FF--F", 2), (with_zones(shipped("reference-t"), 3), "paper", "QFF", 0)],
    ids=["weights of a level", "parabola between frequencies"],
)
def test_no_bound_of_a_share_passes_one(device: Device, objective: str, states: str, level: int) -> None:
    entry = solver_of(device, objective).solve(states_of(states))[level]
    share = 10 ** (-entry.optimality_gap_db / 10) * entry.upper_bound
    assert share <= entry.upper_bound <= 1.0
    assert share > 0.9


@any_case
def test_a_level_is_reached_or_out_of_everyones_reach(case: tuple[str, str, int]) -> None:
    name, states, level = case
    device = DEVICES[name]
    entry = entries_of(device, states)[level]
    state, _ = task_of(device, entry)
    _, power = state.under_fingers(*drive_of(entry))
    weakest_db = decibels(power[0, state.felt].min())
    if not np.isfinite(entry.wanted_level_db):
        assert entry.achieved
    elif entry.achieved:
        assert weakest_db == pytest.approx(entry.wanted_level_db, abs=2e-3)
    else:  # the loudest, as other cases show
        assert weakest_db < entry.wanted_level_db
        assert max(entry.amplitudes) == pytest.approx(device.limits.amplitude)


def standard_figures(device: Device, entry: Entry, touch: int = 0) -> Figures:
    state, _ = task_of(device, entry)
    return state.models[touch].figures(*drive_of(entry))


@any_case
def test_an_entry_promises_what_the_dense_model_gives(case: tuple[str, str, int]) -> None:
    name, states, level = case
    device = DEVICES[name]
    entry = entries_of(device, states)[level]
    state, _ = task_of(device, entry)
    figures = standard_figures(device, entry)
    assert [zone.share for zone in entry.zones] == pytest.approx(figures.share, rel=1e-3, abs=1e-6)
    assert [zone.peak_acceleration_m_per_s2 for zone in entry.zones] == pytest.approx(figures.peak, rel=1e-3)
    assert entry.localized_factor == pytest.approx(figures.share[state.zones_of(FELT)].sum(), rel=1e-3)
    acceleration, power = state.under_fingers(*drive_of(entry))
    fingers = [entry.zones[zone] for zone in state.touched]
    assert [zone.acceleration_at_finger_m_per_s2 for zone in fingers] == pytest.approx(acceleration[0], rel=1e-3)
    level_db = 10 * np.log10(power)
    assert [zone.sensation_level_db for zone in fingers] == pytest.approx(level_db[0], abs=PROMISE_DB)
    assert entry.level_db == pytest.approx(level_db[0, state.felt].min(), abs=PROMISE_DB)
    if state.quiet:
        mean_db = 10 * np.log10(power[1:].mean(axis=0))
        contrast_db = level_db[0, state.felt].min() - level_db[0, state.quiet].max()
        assert entry.contrast_db == pytest.approx(contrast_db, abs=PROMISE_DB)
        expected_db = mean_db[state.felt].min() - mean_db[state.quiet].max()
        assert entry.expected_contrast_db == pytest.approx(expected_db, abs=PROMISE_DB)
    else:
        assert entry.contrast_db is None and entry.expected_contrast_db is None


@any_case
def test_ranges_and_worst_case_are_those_of_the_touches(case: tuple[str, str, int]) -> None:
    name, states, level = case
    device = DEVICES[name]
    entry = entries_of(device, states)[level]
    state, _ = task_of(device, entry)
    level_db = 10 * np.log10(state.under_fingers(*drive_of(entry))[1])
    for finger, zone in enumerate(state.touched):
        both = (level_db[:, finger].min(), level_db[:, finger].max())
        assert entry.zones[zone].sensation_level_range_db == pytest.approx(both, abs=PROMISE_DB)
    weakest, strongest = level_db[:, state.felt].min(axis=1), level_db[:, state.quiet].max(axis=1, initial=-np.inf)
    worst = entry.worst_case
    assert worst.level_db == pytest.approx(weakest.min(), abs=PROMISE_DB)
    if state.quiet:
        assert worst.quiet_level_db == pytest.approx(strongest.max(), abs=PROMISE_DB)
        assert worst.contrast_db == pytest.approx((weakest - strongest).min(), abs=PROMISE_DB)
    else:
        assert worst.quiet_level_db is None and worst.contrast_db is None


@pytest.mark.parametrize("case", first_quick(CASES[:FEW]), ids=["{} {} level {}".format(*case) for case in CASES[:FEW]])
def test_ranges_of_shares_and_peaks_are_those_of_the_touches(case: tuple[str, str, int]) -> None:
    name, states, level = case
    device = DEVICES[name]
    entry = entries_of(device, states)[level]
    state, _ = task_of(device, entry)
    figures = [standard_figures(device, entry, touch) for touch in range(len(state.models))]
    share, peak = np.array([one.share for one in figures]), np.array([one.peak for one in figures])
    for z, zone in enumerate(entry.zones):
        assert zone.share_range == pytest.approx((share[:, z].min(), share[:, z].max()), rel=1e-3, abs=1e-6)
        assert zone.peak_acceleration_range_m_per_s2 == pytest.approx((peak[:, z].min(), peak[:, z].max()), rel=1e-3)
    factor = share[:, state.zones_of(FELT)].sum(axis=1)
    assert entry.worst_case.localized_factor == pytest.approx(factor.min(), rel=1e-3)


@pytest.mark.parametrize("case", RIVALLED[:FEW], ids=["{} {} level {}".format(*case) for case in CASES[:FEW]])
def test_t90_is_that_of_the_slowest_felt_finger_in_the_dense_model(case: tuple[str, str, int]) -> None:
    name, states, level = case
    device = DEVICES[name]
    entry = entries_of(device, states)[level]
    state, _ = task_of(device, entry)
    places_m = np.array([sampled_fingers_of(device).middle_m[zone] for zone in state.zones_of(FELT)])
    step_s = 1e-4
    course, final = state.models[0].envelope(*drive_of(entry), places_m, step_s * np.arange(20000.0))
    outside = np.flatnonzero((abs(course - final) > WITHIN * final).any(axis=1))
    assert entry.t90_s == pytest.approx((outside[-1] + 1) * step_s, rel=0.02, abs=2 * step_s)
    assert entry.worst_case.t90_s >= entry.t90_s


SOME_STATES = {
    "reference-a": ["F--Q-", "FQF-Q", "--F--"],
    "reference-d": ["-FQ--", "FF--Q"],
    "three actuators": ["F-Q-", "FQFQ"],
}
some_states = pytest.mark.parametrize(
    ("name", "states"), [(name, states) for name, every in SOME_STATES.items() for states in every]
)


@some_states
def test_ranges_hold_the_promise_and_the_worst_case_is_in_them(name: str, states: str) -> None:
    for entry in entries_of(DEVICES[name], states):
        felt, quiet = ([zone for zone in entry.zones if zone.state is kind] for kind in (FELT, QUIET))
        for zone in entry.zones:
            assert zone.share_range[0] <= zone.share * (1 + 1e-6) and zone.share <= zone.share_range[1] * (1 + 1e-6)
            least, greatest = zone.peak_acceleration_range_m_per_s2
            assert least <= zone.peak_acceleration_m_per_s2 <= greatest
            assert zone.dead_acceleration_m_per_s2 <= zone.peak_acceleration_m_per_s2
            bar = zip(device_zones(name), entry.zones, strict=True)
            assert all(part.start_m <= one.peak_position_m <= part.stop_m for part, one in bar)
            if zone.sensation_level_range_db is None:
                assert zone.state is FREE and zone.sensation_level_db is None
            else:
                assert zone.sensation_level_db is not None
                low_db, high_db = zone.sensation_level_range_db
                assert low_db - 1e-6 <= zone.sensation_level_db <= high_db + 1e-6
        worst = entry.worst_case
        assert worst.level_db == pytest.approx(min(zone.sensation_level_range_db[0] for zone in felt))  # type: ignore[index]  # fingers
        assert worst.level_db <= entry.level_db + 1e-6
        assert worst.localized_factor <= entry.localized_factor + 1e-6
        if quiet:
            assert worst.contrast_db is not None and entry.contrast_db is not None
            assert worst.contrast_db <= entry.contrast_db + 1e-6
            assert worst.quiet_level_db == pytest.approx(max(zone.sensation_level_range_db[1] for zone in quiet))  # type: ignore[index]  # fingers


def device_zones(name: str) -> tuple[Zone, ...]:
    return DEVICES[name].zones


@some_states
def test_what_is_wanted_louder_has_no_more_of_the_objective(name: str, states: str) -> None:
    above_level = [entry for entry in entries_of(DEVICES[name], states) if entry.objective != "level"]
    for softer, louder in pairwise(above_level):
        if "Q" in states:
            assert softer.expected_contrast_db is not None and louder.expected_contrast_db is not None
            assert louder.expected_contrast_db <= softer.expected_contrast_db + TOLERANCE_DB
        else:
            assert louder.localized_factor <= softer.localized_factor * 10 ** (TOLERANCE_DB / 10)


@some_states
def test_a_level_is_achieved_unless_full_scale_is_below_it(name: str, states: str) -> None:
    *entries, full = entries_of(DEVICES[name], states)
    assert full.achieved and full.wanted_level_db == np.inf
    for entry in entries:
        assert entry.achieved == (full.level_db >= entry.wanted_level_db)
        assert ("out of reach" in entry.limited_by) != entry.achieved
        if not entry.achieved:
            assert entry.frequencies_hz == full.frequencies_hz and entry.amplitudes == full.amplitudes
    assert [entry.level_db for entry in entries] == sorted(entry.level_db for entry in entries)


@some_states
def test_amplitudes_stay_within_the_limit_and_tones_on_the_wire_and_within_the_bands(name: str, states: str) -> None:
    device = DEVICES[name]
    for entry in entries_of(device, states):
        for actuator, hz, amplitude in zip(device.actuators, entry.frequencies_hz, entry.amplitudes, strict=True):
            assert 0.0 <= amplitude <= device.limits.amplitude
            assert amplitude == 0.0 or actuator.band_hz[0] <= hz <= actuator.band_hz[1]
            assert hz == pytest.approx(round(hz, 2), abs=1e-9)
        tones = np.unique(np.array(entry.frequencies_hz)[np.array(entry.amplitudes) > 0])
        assert (np.diff(tones) >= 10.0 - 1e-9).all()


@some_states
def test_played_softer_an_entry_promises_what_the_softer_drive_does(name: str, states: str) -> None:
    device, full = DEVICES[name], entries_of(DEVICES[name], states)[-1]
    softer = scaled_to(full, full.level_db - 13.0)
    state, _ = task_of(device, full)
    acceleration, power = state.under_fingers(*drive_of(softer))
    fingers = [softer.zones[zone] for zone in state.touched]
    assert [zone.acceleration_at_finger_m_per_s2 for zone in fingers] == pytest.approx(acceleration[0], rel=1e-3)
    assert [zone.sensation_level_db for zone in fingers] == pytest.approx(10 * np.log10(power[0]), abs=PROMISE_DB)
    assert softer.level_db == pytest.approx(full.level_db - 13.0)
    assert softer.worst_case.level_db == pytest.approx(full.worst_case.level_db - 13.0)
    assert softer.achieved and softer.localized_factor == full.localized_factor
    assert scaled_to(full, full.level_db + 13.0).amplitudes == full.amplitudes
    assert not scaled_to(full, full.level_db + 13.0).achieved


@pytest.mark.parametrize(("name", "states"), [("reference-a", "F--Q-"), ("reference-d", "-FQ--")])
def test_a_mirrored_bar_has_mirrored_entries(name: str, states: str) -> None:
    device = DEVICES[name]
    for entry, image in zip(entries_of(device, states), entries_of(mirrored(device), states[::-1]), strict=True):
        assert image.level_db == pytest.approx(entry.level_db, abs=1e-3)
        assert image.expected_contrast_db == pytest.approx(entry.expected_contrast_db, abs=TOLERANCE_DB)
        assert image.frequencies_hz == pytest.approx(entry.frequencies_hz, abs=0.5)
        assert image.amplitudes == pytest.approx(entry.amplitudes, abs=0.02)
        for zone, other in zip(entry.zones, reversed(image.zones), strict=True):
            assert other.share == pytest.approx(zone.share, rel=0.02, abs=1e-3)


@pytest.mark.parametrize("states", ["F--Q-", "FQF-Q", "FF---"])
def test_actuators_whose_bands_do_not_meet_each_play_in_their_own(states: str) -> None:
    base = DEVICES["reference-a"]
    left, right = base.actuators
    bands = replace(left, band_hz=(60.0, 120.003)), replace(right, band_hz=(180.004, 300.0))
    device = replace(base, actuators=bands)
    for entry in entries_of(device, states):
        assert entry.family in ("single tone", "two tones")
        for actuator, hz, amplitude in zip(device.actuators, entry.frequencies_hz, entry.amplitudes, strict=True):
            assert amplitude == 0.0 or actuator.band_hz[0] <= hz <= actuator.band_hz[1]


def test_half_the_amplitude_limit_gives_half_the_drive_of_twice_the_level() -> None:
    full = replace(DEVICES["reference-a"], levels_db=(25.0,))
    half_db = 25.0 + 20 * np.log10(0.5)
    half = replace(full, limits=replace(full.limits, amplitude=0.5), levels_db=(half_db,))
    for states in ("F--Q-", "F-F--"):
        for one, other in zip(entries_of(full, states), entries_of(half, states), strict=True):
            assert other.level_db == pytest.approx(one.level_db + 20 * np.log10(0.5), abs=1e-6)
            assert other.amplitudes == pytest.approx([amplitude / 2 for amplitude in one.amplitudes])
            assert other.upper_bound == pytest.approx(
                one.upper_bound + (20 * np.log10(0.5) if one.objective == "level" else 0.0)
            )


def test_a_level_that_only_two_tones_reach_is_achieved() -> None:
    """On this state the loudest coherent drive gives 26.07 dB, the loudest two tones 26.25 dB."""
    device = replace(DEVICES["reference-d"], levels_db=(26.15,))
    entry = entries_of(device, "QF-FF")[0]
    assert entry.achieved
    assert entry.family == "two tones"


def test_one_actuator_is_driven_alone() -> None:
    base = DEVICES["reference-a"]
    device = replace(base, actuators=base.actuators[:1])
    for states in ("F---Q", "--F--"):
        for entry in entries_of(device, states):
            assert entry.family == "single tone"
            assert 0.0 < entry.t90_s < 5.0


def test_one_zone_over_the_whole_bar_has_every_share_and_is_driven_as_loud_as_asked() -> None:
    base = DEVICES["reference-a"]
    device = replace(base, zones=(Zone("all", 0.0, base.bar.length_m),))
    for entry in entries_of(device, "F"):
        assert entry.localized_factor == pytest.approx(1.0)
        assert entry.contrast_db is None and entry.worst_case.contrast_db is None
        assert entry.achieved
        assert entry.level_db == pytest.approx(
            min(entry.wanted_level_db, entries_of(device, "F")[-1].level_db), abs=1e-3
        )


def test_a_table_holds_every_state_with_a_felt_zone() -> None:
    for name, count in (("reference-a", 5), ("three actuators", 4)):
        states = tabulated_states(DEVICES[name])
        assert len(set(states)) == len(states) == 3**count - 2**count
        assert all(FELT in state for state in states)
        assert [state_index(state) for state in states] == sorted(state_index(state) for state in states)


def test_beyond_eight_zones_a_table_holds_the_states_of_few_fingers() -> None:
    base = DEVICES["reference-a"]
    edges = np.linspace(0.0, base.bar.length_m, 11)
    zones = tuple(Zone(str(i), float(a), float(b)) for i, (a, b) in enumerate(pairwise(edges)))
    states = tabulated_states(replace(base, zones=zones))
    touched = [sum(kind is not FREE for kind in state) for state in states]
    assert max(touched) == MOST_TOUCHED_BEYOND
    assert len(states) == sum(comb(10, count) * (2**count - 1) for count in range(1, MOST_TOUCHED_BEYOND + 1))


def test_every_state_of_a_small_bar_is_solved_and_the_fraction_done_ends_at_one() -> None:
    base = DEVICES["reference-a"]
    device = replace(base, zones=base.zones[1:3], levels_db=(20.0,))
    solved = list(solve_entries(assemble(device)))
    assert sorted(entries[0].index for entries, _ in solved) == sorted(map(state_index, tabulated_states(device)))
    assert [done for _, done in solved] == pytest.approx(np.arange(1, 6) / 5)
    for entries, _ in solved:
        assert entries == solver_of(device).solve(entries[0].states)


@pytest.mark.parametrize("objective", OBJECTIVES)
def test_any_objective_is_best_by_its_own_measure(objective: str) -> None:
    device, states = DEVICES["reference-a"], "FQF--"
    measured = {name: measure(objective, solver_of(device, name).solve(states_of(states))[1]) for name in OBJECTIVES}
    assert measured[objective] >= max(measured.values()) - 1e-3


def measure(objective: str, entry: Entry) -> float:
    """What the objective is of an entry, in its own unit; dB where it is a contrast."""
    shares = [zone.share for zone in entry.zones if zone.state is FELT]
    assert entry.contrast_db is not None and entry.expected_contrast_db is not None
    return {
        "contrast": entry.expected_contrast_db,
        "standard contrast": entry.contrast_db,
        "localized factor": sum(shares),
        "fair share": min(shares),
        "paper": untouched_share(entry),
    }[objective]


def untouched_share(entry: Entry) -> float:
    """Of the felt zones together, the entry played on reference-a without fingers."""
    share = bare_model(DEVICES["reference-a"]).figures(*drive_of(entry)).share
    return float(share[[state is FELT for state in entry.states]].sum())
