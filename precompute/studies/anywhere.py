"""Clicks and steady drives for fingers anywhere on the bar: what is played, and what could be had.

A click made for the positions of the fingers is the best that could be had; a table's click of the nearest places is
what a run plays; a click made for the middles of the zones is what a table without places would hold. All three are
evaluated on the same plants. The steady drive is the one that a run solves for the positions.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from base.plain import to_plain
from engine.device import Device
from engine.table import Clicks
from engine.touch import Placement, PlacementError, ZoneState
from engine.touch.finger_tracker import ZoneEdges
from precompute.clicks import DEFAULT_OPTIONS, ClickOptions, ClickSolver
from precompute.clicks.evaluation import Evaluation, evaluate_waveform
from precompute.clicks.solver import FULL_SCALE
from precompute.parallel.pool import WorkerPool
from precompute.predict.at_positions import SteadyDesigner

Array = NDArray[np.float64]

AIM_CONTRAST_DB, STEADY_LEVEL_DB = 18.0, 20.0
"""Expected contrast that a steady drive is to reach at this level."""
AIM_FELT_DB, AIM_QUIET_DB = 14.0, 1.0
"""What a click is to keep: felt by at least this in 95 % of the plants, and quiet at this or below in 95 % of them."""
_PERCENTS = (5, 50, 95)


@dataclass(frozen=True)
class Anywhere:
    """What is compared: random placements, seeded, and the plants that clicks are evaluated on.

    fingers, of which `feeling` feel, lie at least `apart_m` from one another, or exactly so where `is_exact`;
    tolerance_m: a finger lies within this distance of the position that the digitizer tells.
    """

    placements: int = 300
    fingers: int = 2
    feeling: int = 1
    apart_m: float = 25e-3
    is_exact: bool = False
    tolerance_m: float = 1e-3
    plants: int = 300
    seed: int = 1


def random_placements(device: Device, wanted: Anywhere) -> list[Placement]:
    """Placements evenly distributed over the bar, its ends included.

    Raises PlacementError where the bar is too short for them, or where no or too many fingers feel.
    """
    if not 1 <= wanted.feeling <= wanted.fingers:
        raise PlacementError(f"{wanted.feeling} of {wanted.fingers} fingers feel: at least one must, and at most all")
    span_m = device.bar.length_m - wanted.apart_m * (wanted.fingers - 1)
    if span_m < 0:
        raise PlacementError(
            f"{wanted.fingers} fingers {1e3 * wanted.apart_m:g} mm apart do not fit on {1e3 * device.bar.length_m:g} mm"
        )
    random, found = np.random.default_rng(wanted.seed), list[Placement]()
    for _ in range(wanted.placements):
        # Even over all ordered positions that keep the distance: spread without it, then moved apart.
        gaps_m = wanted.apart_m * np.arange(wanted.fingers)
        free_m = np.sort(random.uniform(0, span_m, 1 if wanted.is_exact else wanted.fingers))
        at_m = (free_m + gaps_m).tolist()
        felt = set(random.permutation(wanted.fingers)[: wanted.feeling].tolist())
        found.append(
            Placement.on(
                device,
                [each_m for finger, each_m in enumerate(at_m) if finger in felt],
                [each_m for finger, each_m in enumerate(at_m) if finger not in felt],
            )
        )
    return found


def compare_anywhere(
    device: Device,
    wanted: Anywhere,
    workers: int,
    on_progress: Callable[[float], None],
    options: ClickOptions = DEFAULT_OPTIONS,
    tabulated: Clicks | None = None,
) -> dict[str, Any]:
    """Levels of every placement by the clicks that the module names, and the contrast of its steady drive.

    SIMULATED, on sampled plants that no click was made with. tabulated: clicks of a table of the device. `on_progress`
    is told the fraction done.
    """
    placements, rows = random_placements(device, wanted), dict[int, dict[str, Any]]()
    by_position = replace(options, tolerance_m=wanted.tolerance_m, judged=wanted.plants)
    chunks = [[numbered] for numbered in enumerate(placements)]
    start_s = time.perf_counter()
    begin = partial(_begin, device, by_position, options, tabulated)
    with WorkerPool(min(workers, len(chunks)) - 1) as pool:
        for number, row in pool.solve(begin, chunks, include_self=True):
            rows[number] = row
            on_progress(len(rows) / len(placements))
    ordered = [rows[number] for number in sorted(rows)]
    shared = [row for row in ordered if row["shares_a_zone"]]
    return {
        "simulated": True,
        "device": device.name,
        "estimates": [*device.estimated_values, device.threshold.title],
        "threshold": device.threshold.title,
        "compared": to_plain(wanted),
        "options": to_plain(by_position),
        "spread": to_plain(device.spread),
        "workers": workers,
        "time_s": time.perf_counter() - start_s,
        "placements": ordered,
        "summary": {
            "by_position": _summary([row["by_position"] for row in ordered]),
            "by_table": _summary([row["by_table"] for row in ordered if row["by_table"]]),
            "by_table_in_one_zone": _summary([row["by_table"] for row in shared if row["by_table"]]),
            "by_zone": _summary([row["by_zone"] for row in ordered if row["by_zone"]]),
            "by_position_in_one_zone": _summary([row["by_position"] for row in shared]),
            "steady": _steady_summary([row["steady"] for row in ordered]),
            "processor_ms": np.percentile([1e3 * row["processor_s"] for row in ordered], (50, 99)).tolist(),
        },
    }


def _begin(
    device: Device, by_position: ClickOptions, by_zone: ClickOptions, tabulated: Clicks | None
) -> Callable[[tuple[int, Placement]], tuple[int, dict[str, Any]]]:
    solver = ClickSolver(device, by_position)
    zones = ClickSolver(device, replace(by_zone, judged=2))  # few plants to evaluate on, since that is done here
    zone_click = lru_cache(maxsize=None)(lambda states: zones.solve(Placement.in_zones(device, states)))
    edges, designer = ZoneEdges(device), SteadyDesigner(device, samples=2 * (by_position.judged // 2))
    solver.solve(Placement.on(device, [device.bar.length_m / 2]))  # compiled before it is timed

    def compare(numbered: tuple[int, Placement]) -> tuple[int, dict[str, Any]]:
        number, placement = numbered
        start_s = time.process_time()
        click = solver.solve(placement)
        processor_s = time.process_time() - start_s
        touched = [edges.zone_at(at_m) for at_m in placement.position_m]
        states, by_zone, by_table = placement.zone_states(device), None, None
        if ZoneState.FELT in states:
            middle = zone_click(states)
            by_zone = _evaluate(solver, placement, middle.waveform, middle.evaluation.residual_from_s)
        own = None if tabulated is None else tabulated.at(tabulated.places.key(placement))
        if own is not None:
            by_table = _evaluate(solver, placement, own.samples.T / FULL_SCALE, own.residual_from_s)
        return number, {
            "position_m": placement.position_m,
            "is_felt": placement.is_felt,
            "shares_a_zone": len(set(touched)) < len(touched),
            "by_position": _levels(click.evaluation) | {"bound_db": click.bound_db, "gap_db": click.gap_db},
            "by_table": by_table and _levels(by_table),
            "by_zone": by_zone and _levels(by_zone),
            "steady": _steady(designer, placement),
            "processor_s": processor_s,
        }

    return compare


def _evaluate(solver: ClickSolver, placement: Placement, waveform: Array, residual_from_s: float) -> Evaluation:
    fresh = solver.plants_of(placement.position_m).evaluated
    return evaluate_waveform(waveform, fresh, placement.felt, placement.quiet, residual_from_s)


def _steady(designer: SteadyDesigner, placement: Placement) -> dict[str, Any]:
    """The drive of a placement at STEADY_LEVEL_DB; the contrast is None where nothing is quiet."""
    figures = designer.solve(placement.position_m, placement.is_felt, STEADY_LEVEL_DB)
    return {
        "achieved": figures.drive.achieved,
        "level_db": figures.drive.weakest_felt_db,
        "expected_contrast_db": figures.expected_contrast_db,
    }


def _levels(evaluation: Evaluation) -> dict[str, Any]:
    return {"felt_db": to_plain(evaluation.felt), "quiet_db": to_plain(evaluation.quiet)}


def _steady_summary(drives: list[dict[str, Any]]) -> dict[str, Any]:
    """Percentiles of the expected contrast over the placements where full scale reaches the level, and the share."""
    contrasts_db = [drive["expected_contrast_db"] for drive in drives if drive["achieved"]]
    known_db = np.array([contrast_db for contrast_db in contrasts_db if contrast_db is not None])
    return {
        "level_db": STEADY_LEVEL_DB,
        "placements": len(drives),
        "achieved": len(contrasts_db),
        "expected_contrast_db": np.percentile(known_db, _PERCENTS).tolist() if len(known_db) else None,
        "share_that_keeps_the_aim": float((known_db >= AIM_CONTRAST_DB).mean()) if len(known_db) else None,
    }


def _summary(figures: list[dict[str, Any]]) -> dict[str, Any]:
    """Percentiles over placements of the level that 95 % of the plants exceed where felt, and keep to where quiet."""
    if not figures:
        return {"placements": 0}
    felt_db = np.array([each["felt_db"]["low_db"] for each in figures])
    quiet_db = np.array([each["quiet_db"]["high_db"] if each["quiet_db"] else -np.inf for each in figures])
    return {
        "placements": len(figures),
        "felt_db": np.percentile(felt_db, _PERCENTS).tolist(),
        "quiet_db": np.percentile(quiet_db, _PERCENTS).tolist() if np.isfinite(quiet_db).all() else None,
        "share_that_keeps_the_aim": float(((felt_db >= AIM_FELT_DB) & (quiet_db <= AIM_QUIET_DB)).mean()),
    }
