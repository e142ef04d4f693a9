"""Clicks and steady drives for fingers anywhere on a surface: what is played, and what could be had. SIMULATED.

    python -m tests.studies.physics.anywhere reference-a --table reference-a.nc
    python -m tests.studies.physics.anywhere reference-a --distances 8,10,15,20 --placements 40
    python -m tests.studies.physics.anywhere reference-p --actuators 8 --change "plate.thickness=0.7 mm"

A click made for the positions of the fingers is the best that could be had; a table's click of the nearest places is
what a run plays; a click made for the middles of the zones is what a table without places would hold. All three are
evaluated on the same plants. The steady drive is the one that a run solves for the positions.
"""

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from base.arrays import Array
from base.plain import to_plain
from base.points import point_at
from engine.device import Device
from engine.table import Clicks, Table
from engine.table.clicks import ClickFigures
from engine.touch import Placement, ZoneState
from engine.touch.finger_tracker import ZoneFinder
from precompute.clicks import DEFAULT_OPTIONS, ClickOptions, ClickSolver
from precompute.parallel.pool import WorkerPool, available_cores
from precompute.predict.at_positions import SteadyDesigner
from precompute.sampling.placements import Anywhere, random_placements
from precompute.studies.placement_search import with_actuators_at
from tactable.shipped import find_device
from tests.studies.options import read_options

AIM_CONTRAST_DB, STEADY_LEVEL_DB = 18.0, 20.0
"""Expected contrast that a steady drive is to reach at this level."""
AIM_FELT_DB, AIM_QUIET_DB = 14.0, 1.0
"""What a click is to keep: felt by at least this in 95 % of the plants, and quiet at this or below in 95 % of them."""
PLANTS, TOLERANCE_M, ZONE_TOLERANCE_M = 300, 1e-3, 4e-3  # the last: of clicks that are made for middles of zones
"""Fresh plants of each placement, and how far a finger may lie from the position that the digitizer tells."""
_CORNERS = (0.1 + 0.139j, 0.9 + 0.194j, 0.117 + 0.861j, 0.873 + 0.822j)
AROUND_A_PLATE = (*_CORNERS, 0.5 + 0.111j, 0.483 + 0.889j, 0.067 + 0.5j, 0.94 + 0.472j)
"""Where `--actuators` puts them, in fractions of a plate: near its corners, as on reference-p, then along its sides."""
_PERCENTS = (5, 50, 95)
_WAYS = {
    "by_position": "made for the positions",
    "by_position_in_one_zone": "of these, two fingers in one zone",
    "by_table": "of the table, for the nearest places",
    "by_table_in_one_zone": "of these, two fingers in one zone",
    "by_zone": "made for the middles of the zones",
}


def compare_anywhere(
    device: Device,
    wanted: Anywhere,
    workers: int,
    options: ClickOptions = DEFAULT_OPTIONS,
    tabulated: Clicks | None = None,
    plants: int = PLANTS,
    is_brief: bool = False,
) -> dict[str, Any]:
    """Levels of every placement by the clicks that the module names, and the contrast of its steady drive.

    On sampled plants that no click was made with. tabulated: clicks of a table of the device. is_brief: only clicks
    made for the positions.
    """
    placements, rows = random_placements(device, wanted), dict[int, dict[str, Any]]()
    by_position = replace(options, tolerance_m=TOLERANCE_M, judged=plants)
    chunks = [[numbered] for numbered in enumerate(placements)]
    start_s = time.perf_counter()
    by_zone = None if is_brief else replace(options, tolerance_m=ZONE_TOLERANCE_M)
    begin = partial(_begin, device, by_position, by_zone, tabulated)
    with WorkerPool(min(workers, len(chunks)) - 1) as pool:
        rows.update(pool.solve(begin, chunks, include_self=True))
    ordered = [rows[number] for number in sorted(rows)]
    shared = [row for row in ordered if row["shares_a_zone"]]
    return {
        "time_s": time.perf_counter() - start_s,
        "placements": ordered,
        "by_position": _summary([row["by_position"] for row in ordered]),
        "by_table": _summary([row["by_table"] for row in ordered if row["by_table"]]),
        "by_table_in_one_zone": _summary([row["by_table"] for row in shared if row["by_table"]]),
        "by_zone": _summary([row["by_zone"] for row in ordered if row["by_zone"]]),
        "by_position_in_one_zone": _summary([row["by_position"] for row in shared]),
        "steady": _steady_summary([row["steady"] for row in ordered if row["steady"]]),
        "processor_ms": np.percentile([1e3 * row["processor_s"] for row in ordered], (50, 99)).tolist(),
    }


def _middles(device: Device, states: Sequence[ZoneState]) -> Placement:
    """A finger in the middle of every zone that is not free."""
    felt, quiet = (
        [zone.name for zone, state in zip(device.zones, states, strict=True) if state is wanted]
        for wanted in (ZoneState.FELT, ZoneState.QUIET)
    )
    return Placement.named(device, felt, quiet)


def _begin(
    device: Device, by_position: ClickOptions, by_zone: ClickOptions | None, tabulated: Clicks | None
) -> Callable[[tuple[int, Placement]], tuple[int, dict[str, Any]]]:
    solver, edges = ClickSolver(device, by_position), ZoneFinder(device)
    compare_others = None if by_zone is None else _begin_others(device, solver, by_zone, tabulated)
    solver.solve(Placement.on(device, [device.surface.corner_m / 2]))  # compiled before it is timed

    def compare(numbered: tuple[int, Placement]) -> tuple[int, dict[str, Any]]:
        number, placement = numbered
        start_s = time.thread_time()
        click = solver.solve(placement)
        processor_s = time.thread_time() - start_s
        touched = [edges.zone_at(at_m) for at_m in placement.position_m]
        others = compare_others(placement) if compare_others else dict.fromkeys(("by_table", "by_zone", "steady"))
        return number, {
            "position_m": placement.position_m,
            "is_felt": placement.is_felt,
            "shares_a_zone": len(set(touched)) < len(touched),
            "by_position": _levels(click),
            "processor_s": processor_s,
            **others,
        }

    return compare


def _begin_others(
    device: Device, solver: ClickSolver, by_zone: ClickOptions, tabulated: Clicks | None
) -> Callable[[Placement], dict[str, Any]]:
    """Clicks that were made for other positions, and the steady drive."""
    zones = ClickSolver(device, replace(by_zone, judged=2))  # few plants to evaluate on, since that is done here
    zone_click = lru_cache(maxsize=None)(lambda states: zones.solve(_middles(device, states)))
    designer = SteadyDesigner(device, samples=2 * (solver.options.judged // 2))

    def compare(placement: Placement) -> dict[str, Any]:
        states, waveforms = placement.zone_states(device), dict[str, Array]()
        if ZoneState.FELT in states:
            waveforms["by_zone"] = zone_click(states).waveform.T
        own = None if tabulated is None else tabulated.at(tabulated.places.key(placement))
        if own is not None:
            waveforms["by_table"] = own.waveform.T
        levels = {way: _levels(solver.evaluate(placement, each)) for way, each in waveforms.items()}
        return {"by_table": None, "by_zone": None, **levels, "steady": _steady(designer, placement)}

    return compare


def _steady(designer: SteadyDesigner, placement: Placement) -> dict[str, Any]:
    """The drive of a placement at STEADY_LEVEL_DB; the contrast is None where nothing is quiet."""
    figures = designer.solve(placement.position_m, placement.is_felt, STEADY_LEVEL_DB)
    return {
        "achieved": figures.drive.achieved,
        "level_db": figures.drive.weakest_felt_db,
        "expected_contrast_db": figures.expected_contrast_db,
    }


def _levels(evaluation: ClickFigures) -> dict[str, Any]:
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
        "share_that_keeps_the_aim": kept_share(felt_db, quiet_db),
    }


def kept_share(felt_db: ArrayLike, quiet_db: ArrayLike, most_db: float = AIM_QUIET_DB) -> float:
    """Share of the placements (placement,) that keep AIM_FELT_DB and a quiet level of at most `most_db`."""
    return float(((np.asarray(felt_db) >= AIM_FELT_DB) & (np.asarray(quiet_db) <= most_db)).mean())


def contrast_cells(pairs: Sequence[tuple[float, float]]) -> str:
    """Cells of a table: contrast in 5, 50 % and quiet in 50, 95 % of placements by (felt 5 %, quiet 95 %), dB."""
    felt_db, quiet_db = np.array(pairs).T
    return f"{_text(np.percentile(felt_db - quiet_db, (5, 50)))} | {_text(np.percentile(quiet_db, (50, 95)))}"


def _text(levels_db: Iterable[float]) -> str:
    return " / ".join(f"{level_db:z.1f}" for level_db in levels_db)


def describe(device: Device, wanted: Anywhere, result: dict[str, Any]) -> list[str]:
    """The summary in lines: a row of a table for each way, the steady drives, and the spreads that it holds for."""
    distance = f"{1e3 * wanted.apart_m:g} mm {'' if wanted.is_exact else 'or more '}apart"
    lines = [
        f"{device.name}, {wanted.fingers} fingers, {wanted.feeling} felt, {distance}, SIMULATED: felt (5 % of plants), "
        f"quiet (95 %), {_PERCENTS} % of placements; share with felt >= {AIM_FELT_DB:g} and quiet <= {AIM_QUIET_DB:g}"
    ]
    for way, name in _WAYS.items():
        if (figures := result[way])["placements"]:
            felt, quiet = (_text(figures[key] or []) for key in ("felt_db", "quiet_db"))
            share = f"{100 * figures['share_that_keeps_the_aim']:.1f} %"
            lines.append(f"{figures['placements']:4d} {name}: felt {felt} dB, quiet {quiet} dB, both {share}")
    steady = result["steady"]
    if steady["expected_contrast_db"] is not None:
        lines.append(
            f"steady drives for the positions: full scale reaches {STEADY_LEVEL_DB:g} dB in {steady['achieved']} of "
            f"{steady['placements']}; there the expected contrast is {_text(steady['expected_contrast_db'])} dB, at "
            f"least {AIM_CONTRAST_DB:g} dB in {100 * steady['share_that_keeps_the_aim']:.1f} %"
        )
    middle_ms, last_ms = result["processor_ms"]
    return [
        *lines,
        f"dB above the {device.threshold.title}; made for and judged on the spread {device.spread_text}, each finger "
        f"within {1e3 * TOLERANCE_M:g} mm; seed {wanted.seed}",
        f"a click takes {middle_ms:.0f} ms of processor time (median; 99 %: {last_ms:.0f}); {result['time_s']:.0f} s",
        f"ESTIMATES: {', '.join([*device.estimated_values, device.threshold.title])}",
    ]


def draw(device: Device, distances_m: Sequence[float], found: Sequence[dict[str, Any]]) -> Figure:
    """Levels and the share that keeps both aims against the distance between two fingers."""
    figure, distance_mm = Figure(figsize=(9, 4.6), layout="constrained"), 1e3 * np.array(distances_m)
    what = f"{device.name}: two fingers anywhere, one felt, SIMULATED"
    figure.suptitle(f"{what}\ndB above the {device.threshold.title}", fontsize="medium")
    left, right = figure.subplots(1, 2)
    for way, line in (("by_position", "-"), ("by_zone", ":")):
        if not found[0][way]["placements"]:
            continue
        for key, colour, name in (("felt_db", "C0", "felt (5 %)"), ("quiet_db", "C1", "quiet (95 %)")):
            low, middle, high = np.array([summary[way][key] for summary in found]).T
            if line == "-":
                left.fill_between(distance_mm, low, high, color=colour, alpha=0.18, lw=0)
            left.plot(distance_mm, middle, f"o{line}", color=colour, ms=4, label=f"{name}, {_WAYS[way]}")
        share = [100 * summary[way]["share_that_keeps_the_aim"] for summary in found]
        right.plot(distance_mm, share, f"o{line}", color="C0", label=_WAYS[way])
    left.set(xlabel="distance between the fingers (mm)", ylabel="level (dB above threshold)")
    left.set_title("5 to 95 % of the placements, and the middle", fontsize="small", loc="left")
    right.set(xlabel="distance between the fingers (mm)", ylabel="placements (%)", ylim=(-2, 102))
    right.set_title(f"felt >= {AIM_FELT_DB:g} dB and quiet <= {AIM_QUIET_DB:g} dB", fontsize="small", loc="left")
    for axes in (left, right):
        axes.grid(alpha=0.25)
    left.set_ylim(top=48)  # room for the legend
    left.legend(fontsize="x-small", loc="upper right")
    right.legend(fontsize="x-small")
    return figure


def changed(device: Device, changes: str, actuators: int) -> Device:
    """The device with values as "key=text,..." says, and a plate with that many actuators around it (0: its own)."""
    device = device.with_values(dict(change.split("=") for change in changes.split(",") if change))
    if not actuators:
        return device
    corner_m = device.surface.corner_m
    return with_actuators_at(device, [point_at(corner_m, at.real, at.imag) for at in AROUND_A_PLATE[:actuators]])


def main() -> None:
    """Compare at random placements, or at each of some distances, which are drawn too."""
    options = {"table": "", "distances": "", "change": "", "actuators": 0, "brief": False}
    asked = read_options(__doc__, device=str, placements=300, fingers=2, felt=1, **options)
    device, tabulated = changed(find_device(asked.device), asked.change, asked.actuators), None
    wanted = Anywhere(placements=asked.placements, fingers=asked.fingers, feeling=asked.felt)
    if asked.table:
        with Table.open(asked.table, device=device) as table:
            tabulated = table.clicks
    exact = [replace(wanted, apart_m=float(mm) / 1e3, is_exact=True) for mm in asked.distances.split(",") if mm]
    found = list[dict[str, Any]]()
    for each in exact or [wanted]:
        found.append(compare_anywhere(device, each, available_cores(), tabulated=tabulated, is_brief=asked.brief))
        print("\n".join(describe(device, each, found[-1])), flush=True)
    if exact:
        draw(device, [each.apart_m for each in exact], found).savefig("distance.png", dpi=110)


if __name__ == "__main__":
    main()
