"""The summary of a fleet as a page: how many are done, what failed and why, what varies, and which units stand out."""

from collections import Counter
from pathlib import Path

from rich.console import Console
from rich.table import Table as Grid
from rich.text import Text

from precompute.fleet.summary import FEWEST, OUTLYING, Column, Summary, status_of

_SHOWN = 20


def print_fleet(out: Console, summary: Summary, path: Path) -> None:
    """`path`: where the whole of it is."""
    counts = Counter(status_of(outcome) for outcome in summary.outcomes)
    parts = (f"{counts['built']} built", f"{counts['kept']} complete already", f"{counts['failed']} failed")
    _line(out, f"{len(summary.outcomes)} units: {', '.join(parts)}")
    for outcome in summary.failed:
        _line(out, f"FAILED {outcome.name}: {outcome.error}")
    doubtful = [outcome for outcome in summary.outcomes if outcome.doubts]
    for outcome in doubtful[:_SHOWN]:
        _line(out, f"doubtful {outcome.name}: {'; '.join(outcome.doubts)}")
    _more(out, len(doubtful))
    if summary.columns:
        grid = Grid("what varies", "median", "spread", "least", "greatest")
        for column in summary.columns:
            grid.add_row(Text(column.name), f"{column.median:.5g}", f"{column.spread:.2g}", *_ends(column))
        out.print(grid)
    for outlier in summary.outliers[:_SHOWN]:
        _line(
            out,
            f"stands out {outlier.unit}: {outlier.column} is {outlier.value:.5g}, "
            f"{outlier.deviation:+.1f} spreads from the median",
        )
    _more(out, len(summary.outliers))
    if not summary.outliers:
        _line(out, f"no unit stands out by more than {OUTLYING} spreads; of fewer than {FEWEST} none ever does")
    _line(out, f"all of it: {path}")


def _line(out: Console, text: str) -> None:
    out.print(text, markup=False, highlight=False, soft_wrap=True)


def _more(out: Console, count: int) -> None:
    if count > _SHOWN:
        _line(out, f"  and {count - _SHOWN} more")


def _ends(column: Column) -> tuple[Text, Text]:
    return (
        Text(f"{column.least:.5g} ({column.least_unit})"),
        Text(f"{column.greatest:.5g} ({column.greatest_unit})"),
    )
