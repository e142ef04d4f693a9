"""Clicks for fingers anywhere on the bar: made for their positions, and made for their zones, on the same plants."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.device import Device
from engine.plain import to_plain
from engine.touch import Placement, PlacementError, ZoneState
from engine.touch.finger_tracker import ZoneEdges
from precompute.clicks import DEFAULT_OPTIONS, Click, ClickOptions, ClickSolver
from precompute.clicks.evaluation import Evaluation, evaluate_waveform
from precompute.entries.prediction import States
from precompute.model.threshold import THRESHOLD_NAME
from precompute.parallel.pool import solve_in_processes

Array = NDArray[np.float64]

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
) -> dict[str, Any]:
    """Levels of every placement, by clicks made for its positions and by those made for the middles of its zones.

    SIMULATED, on sampled plants that no click was made with. `on_progress` is told the fraction done.
    """
    placements, rows = random_placements(device, wanted), dict[int, dict[str, Any]]()
    by_position = replace(options, tolerance_m=wanted.tolerance_m, judged=wanted.plants)
    chunks = [[numbered] for numbered in enumerate(placements)]
    start_s = time.perf_counter()
    for number, row in solve_in_processes(partial(_begin, device, by_position, options), chunks, workers):
        rows[number] = row
        on_progress(len(rows) / len(placements))
    ordered = [rows[number] for number in sorted(rows)]
    shared = [row for row in ordered if row["shares_a_zone"]]
    return {
        "simulated": True,
        "device": device.name,
        "estimates": [*device.inferred, THRESHOLD_NAME],
        "threshold": THRESHOLD_NAME,
        "compared": to_plain(wanted),
        "options": to_plain(by_position),
        "spread": to_plain(device.spread),
        "workers": workers,
        "time_s": time.perf_counter() - start_s,
        "placements": ordered,
        "summary": {
            "by_position": _summary([row["by_position"] for row in ordered]),
            "by_zone": _summary([row["by_zone"] for row in ordered if row["by_zone"]]),
            "by_position_in_one_zone": _summary([row["by_position"] for row in shared]),
            "processor_ms": np.percentile([1e3 * row["processor_s"] for row in ordered], (50, 99)).tolist(),
        },
    }


def _begin(
    device: Device, by_position: ClickOptions, by_zone: ClickOptions
) -> Callable[[tuple[int, Placement]], tuple[int, dict[str, Any]]]:
    solver = ClickSolver(device, by_position)
    zones = ClickSolver(device, replace(by_zone, judged=2))  # few plants to evaluate on, since that is done here
    zone_click = lru_cache(maxsize=None)(lambda states: zones.solve(Placement.in_zones(device, states)))
    edges = ZoneEdges(device)
    solver.solve(Placement.on(device, [device.bar.length_m / 2]))  # compiled before it is timed

    def compare(numbered: tuple[int, Placement]) -> tuple[int, dict[str, Any]]:
        number, placement = numbered
        start_s = time.process_time()
        click = solver.solve(placement)
        processor_s = time.process_time() - start_s
        touched = [edges.zone_at(at_m) for at_m in placement.position_m]
        states = _states(len(device.zones), touched, placement)
        by_zone = _evaluate(solver, placement, zone_click(states)) if ZoneState.FELT in states else None
        return number, {
            "position_m": placement.position_m,
            "is_felt": placement.is_felt,
            "shares_a_zone": len(set(touched)) < len(touched),
            "by_position": _levels(click.evaluation) | {"bound_db": click.bound_db, "gap_db": click.gap_db},
            "by_zone": by_zone and _levels(by_zone),
            "processor_s": processor_s,
        }

    return compare


def _states(zones: int, touched: list[int | None], placement: Placement) -> States:
    """States of the zones with these fingers; a zone is felt if one of its fingers feels."""
    states = [ZoneState.FREE] * zones
    for zone, is_felt in zip(touched, placement.is_felt, strict=True):
        if zone is not None:
            states[zone] = max(states[zone], ZoneState.FELT if is_felt else ZoneState.QUIET)
    return tuple(states)


def _evaluate(solver: ClickSolver, placement: Placement, click: Click) -> Evaluation:
    fresh = solver.plants_of(placement.position_m).evaluated
    return evaluate_waveform(click.waveform, fresh, placement.felt, placement.quiet, click.evaluation.residual_from_s)


def _levels(evaluation: Evaluation) -> dict[str, Any]:
    return {"felt_db": to_plain(evaluation.felt), "quiet_db": to_plain(evaluation.quiet)}


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
