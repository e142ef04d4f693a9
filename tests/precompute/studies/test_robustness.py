"""Laws of the study of robustness: clicks keep what they promise where nothing is changed, and less where much is."""

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from base.arrays import Array
from engine.device import Device
from precompute.clicks import DEFAULT_OPTIONS, ClickSolver
from precompute.parallel.pool import WorkerPool
from precompute.sampling.placements import Anywhere, random_placements
from precompute.sampling.plants import Scenarios, sample_scenarios
from precompute.studies.robustness import BRANCHES, CHANGES, Change, kept_of, peaks_on, study_robustness
from tests.precompute.devices import every_device, shipped

NOTHING = CHANGES[0]
NO_PROGRESS = lambda _: None  # noqa: E731
WORST = ("quiet finger 3 mm on", "position within 4 mm", "bolts that spread", "bolts that clamp", "fingers threefold")


def studied(
    device: Device, changes: tuple[Change, ...], plants: int = 24, placements: int = 6
) -> list[tuple[float, ...]]:
    (rows,) = study_robustness([device], changes, plants, placements, NO_PROGRESS, WorkerPool(0))
    return [(row.faint, row.clear, row.low_contrast_db, row.contrast_db) for row in rows]


class Played:
    """Clicks of a few placements, and their levels (change, placement, finger) in dB on a plant."""

    def __init__(self, device: Device, placements: int = 4) -> None:
        self.solver = ClickSolver(device, DEFAULT_OPTIONS.at_fingers)
        self.where = random_placements(device, Anywhere(placements))
        self.clicks = [self.solver.solve(placement) for placement in self.where]

    def levels_db(self, scenarios: Scenarios, plant: int, *changes: Change) -> Array:
        waveform = np.stack([click.waveform.T for click in self.clicks])[:, None]
        peaks = peaks_on(scenarios, self.where, waveform, changes, plant)
        return 20 * np.log10(peaks[:, :, 0])


def late(device: Device) -> Device:
    """With a channel that is known to be late, through an actuator that is known to lag."""
    fall = [(f, 1 / np.hypot(1, f / 900), -np.degrees(np.arctan(f / 900))) for f in (60, 120, 200, 300)]
    points: Any = [[f"{f} Hz", f"{100 * size:.4f} %", f"{lag:.4f} deg"] for f, size, lag in fall]
    return device.with_values({"actuator[1].transfer": points, "actuator[2].delay": "90 us"})


@pytest.mark.parametrize("device", [*every_device().values(), late(shipped("reference-a"))])
def test_on_the_plants_of_the_solver_the_levels_are_the_solvers_own(device: Device) -> None:
    played = Played(device)
    for plant in (0, 5):
        (found,) = played.levels_db(played.solver.scenarios[1], plant, NOTHING)
        for placement, click, levels_db in zip(played.where, played.clicks, found, strict=True):
            judged = played.solver.plants_of(placement.position_m).judged
            expected_db = 20 * np.log10(judged.peaks(click.waveform.T, (0, 1))[plant])
            felt, quiet = placement.felt[0], placement.quiet[0]
            assert levels_db[felt] == pytest.approx(expected_db[felt], abs=0.1)
            # Where actuators cancel, what the solver leaves out above 1 kHz is a part of what remains.
            assert levels_db[quiet] == pytest.approx(expected_db[quiet], abs=0.25)


def test_with_nothing_changed_clicks_keep_their_promise_on_fresh_plants() -> None:
    played = Played(shipped("reference-a"), 3)
    scenarios = sample_scenarios(played.solver.device, 250, 7)
    levels_db = np.array([played.levels_db(scenarios, plant, NOTHING)[0] for plant in range(1, 251)])
    for index, (placement, click) in enumerate(zip(played.where, played.clicks, strict=True)):
        assert click.quiet is not None
        felt_db, quiet_db = (levels_db[:, index, role[0]] for role in (placement.felt, placement.quiet))
        assert np.percentile(felt_db, 5) == pytest.approx(click.felt.low_db, abs=0.2)
        # Of 250 plants this percentile has a standard error of 0.4 dB.
        assert np.percentile(quiet_db, 95) == pytest.approx(click.quiet.high_db, abs=1.0)


def test_every_field_of_a_change_changes_levels_and_next_to_nothing_of_it_next_to_nothing() -> None:
    device = shipped("reference-a")
    played, scenarios = Played(device), sample_scenarios(device, 2, 5)
    slight: dict[str, Any] = {
        "bits": 30, "youngs_modulus": 1e-9, "length": 1e-9, "damping": 1 + 1e-9, "gain": 1e-9, "late_s": 1e-12,
        "within_m": 1e-3 + 1e-12, "onward_m": 1e-12, "spread_m": 1e-7, "clamp_m": 1e-7,
    }  # fmt: skip
    great: dict[str, Any] = {
        "bits": 5, "youngs_modulus": -0.02, "length": 0.01, "damping": 0.5, "gain": 0.1, "late_s": 1e-4,
        "within_m": 4e-3, "onward_m": 3e-3, "spread_m": 16e-3, "clamp_m": 20e-3, "fingers": 3.0, "finger": "mass",
    }  # fmt: skip
    assert {each.name for each in fields(Change)} == {"name", *great}
    changes = [Change(key, **{key: value}) for values in (slight, great) for key, value in values.items()]
    nothing, again, *found = played.levels_db(scenarios, 1, NOTHING, replace(NOTHING, name="again"), *changes)
    assert (again == nothing).all()
    for key, levels_db in zip(slight, found[: len(slight)], strict=True):
        assert levels_db == pytest.approx(nothing, abs=2e-3), key
    for key, levels_db in zip(great, found[len(slight) :], strict=True):
        assert abs(levels_db - nothing).max() > 0.1, key


def test_what_the_bench_does_not_have_costs_most() -> None:
    worst = tuple(change for change in CHANGES if change.name.startswith(WORST))
    assert len(worst) == len(WORST)
    nothing, *others = studied(shipped("reference-a"), (NOTHING, *worst))
    for kept in others:
        assert kept[0] < nothing[0] and kept[3] < nothing[3] - 1


def test_a_study_repeats_and_devices_are_judged_on_the_same_plants() -> None:
    device = shipped("reference-d")
    rows = study_robustness([device, device], CHANGES[:2], 4, 3, NO_PROGRESS, WorkerPool(0))
    assert rows[0] == rows[1] == study_robustness([device], CHANGES[:2], 4, 3, NO_PROGRESS, WorkerPool(0))[0]


def test_shares_and_contrasts_are_over_placements_of_percentiles_over_plants() -> None:
    level_db = np.tile([[20.0, 0.5], [3.0, 15.0], [13.9, -9.0], [30.0, 6.5]], (40, 1, 1))
    level_db[0] = -level_db[0]  # one plant in forty: no percentile sees it
    kept = kept_of(10 ** (level_db / 20), np.array([0, 1, 0, 0]))
    assert (kept.faint, kept.clear, kept.quiet) == (0.25, 0.5, 0.75)
    assert kept.contrast_db == pytest.approx(np.median([19.5, 12.0, 22.9, 23.5]))


def test_branches_are_a_fractional_damper_over_the_band() -> None:
    s, (stiffness, damping) = 2j * np.pi * np.array([60.0, 100.0, 160.0, 250.0, 300.0]), BRANCHES.T
    found = (s[:, None] * stiffness / (s[:, None] + stiffness / damping)).sum(axis=1)
    match = 2j * np.pi * 160
    assert found == pytest.approx(abs(match) * (s / abs(match)) ** 0.7 / np.sin(0.35 * np.pi), rel=0.04)
    assert found[2].real == pytest.approx(509, abs=1)
