"""The page of the benchmark of fingers anywhere: levels of clicks made for positions, of a table, and for zones."""

from typing import Any

from rich.console import Console
from rich.table import Table as Grid

from precompute.studies.anywhere import AIM_CONTRAST_DB, AIM_FELT_DB, AIM_QUIET_DB

_WAYS = {
    "by_position": "made for the positions",
    "by_position_in_one_zone": "of these, two fingers in one zone",
    "by_table": "of the table, for the nearest places",
    "by_table_in_one_zone": "of these, two fingers in one zone",
    "by_zone": "made for the middles of the zones",
}


def print_anywhere_bench(out: Console, result: dict[str, Any]) -> None:
    """The summary as a table, with the spreads that it holds for."""
    wanted, spread, summary = result["compared"], result["spread"], result["summary"]
    distance = f"{1e3 * wanted['apart_m']:g} mm {'' if wanted['is_exact'] else 'or more '}apart"
    grid = Grid(
        "clicks",
        "placements",
        "felt dB (5 %)",
        "quiet dB (95 %)",
        f"felt ≥ {AIM_FELT_DB:g} and quiet ≤ {AIM_QUIET_DB:g}",
        title=f"{result['device']}, {wanted['fingers']} fingers, {wanted['feeling']} felt, {distance}, SIMULATED",
        caption="5th, 50th and 95th percentile over the placements",
    )
    for key, name in _WAYS.items():
        figures = summary[key]
        if figures["placements"]:
            levels = [" / ".join(f"{level:z.1f}" for level in figures[kind] or []) for kind in ("felt_db", "quiet_db")]
            grid.add_row(
                name, str(figures["placements"]), *levels, f"{100 * figures['share_that_keeps_the_aim']:.1f} %"
            )
    out.print(grid)
    middle_ms, last_ms = summary["processor_ms"]
    for line in (
        *_steady_lines(summary["steady"]),
        f"dB above the {result['threshold']}: 5 % felt and 95 % quiet of {wanted['plants']} fresh plants for each "
        f"placement; stiffness {100 * spread['stiffness']:g} %, mass {100 * spread['mass']:g} %, finger "
        f"{100 * spread['finger']:g} %, position within {1e3 * wanted['tolerance_m']:g} mm; seed {wanted['seed']}",
        f"a click takes {middle_ms:.0f} ms of processor time (median; 99 %: {last_ms:.0f} ms); "
        f"{result['time_s']:.0f} s by {result['workers']} processes",
    ):
        out.print(line, highlight=False, soft_wrap=True)
    out.print(f"ESTIMATES: {', '.join(result['estimates'])}", style="dim", soft_wrap=True)


def _steady_lines(steady: dict[str, Any]) -> list[str]:
    """Contrast of the steady drives; none where no finger is quiet."""
    if steady["expected_contrast_db"] is None:
        return []
    levels = " / ".join(f"{level_db:z.1f}" for level_db in steady["expected_contrast_db"])
    reached = f"{steady['achieved']} of {steady['placements']} placements"
    return [
        f"steady drives solved for the positions: full scale reaches {steady['level_db']:g} dB in {reached}; "
        f"there the expected contrast is {levels} dB (5, 50, 95 %), at least "
        f"{AIM_CONTRAST_DB:g} dB in {100 * steady['share_that_keeps_the_aim']:.1f} %"
    ]
