"""Console of the commands: lines and pages for people, JSON for machines, errors and progress on standard error.

Whatever is printed passes through `SafeConsole.render`, which replaces characters that would command the terminal.
"""

import errno
import json
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from rich.table import Table

from rich.console import Console, ConsoleOptions, RenderableType
from rich.measure import Measurement
from rich.segment import Segment

from base.printable import printable

_WIDEST = 1000
EXIT_DOUBTFUL = 3  # done, but not to be used without a look: a doubtful fit, a failed unit, a deviation


class SafeConsole(Console):
    """A console that shows every text and obeys none, and cuts off no cell of a table."""

    def print(self, *objects: Any, **how: Any) -> None:
        """As Console; a table wider than the terminal is printed whole, for a figure without its end is a wrong one."""
        tables, width = sys.modules.get("rich.table"), self._width
        for each in objects:
            if tables is not None and isinstance(each, tables.Table):
                self._width = self._fit(each)
        try:
            super().print(*objects, **how)
        finally:
            self._width = width

    def _fit(self, table: "Table") -> int:
        """Give every column the width of its longest word, and the room that is left to those that want most of it."""
        wide = self.options.update(max_width=_WIDEST)
        sizes = [
            [Measurement.get(self, wide, cell) for cell in (column.header, *column.cells)] for column in table.columns
        ]
        wanted = [max(cell.maximum for cell in cells) for cells in sizes]
        beside = Measurement.get(self, wide, table).maximum - sum(wanted)  # borders and padding
        given = [
            size if column.no_wrap else max(cell.minimum for cell in cells)
            for column, size, cells in zip(table.columns, wanted, sizes, strict=True)
        ]
        for _ in range(min(sum(wanted), self.width - beside) - sum(given)):
            given[max(range(len(given)), key=lambda k: wanted[k] - given[k])] += 1
        for column, size in zip(table.columns, given, strict=True):
            column.width = size
        return max(sum(given) + beside, self.width)

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """The same as Console, with `printable` text; the console's own codes are in segments of their own."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else segment._replace(text=printable(segment.text))


OUT = SafeConsole(markup=False, emoji=False)  # as they are: neither brackets nor ":x:" in names are markup
ERRORS = SafeConsole(stderr=True, markup=False, emoji=False)
_Result = TypeVar("_Result")
Progress = Callable[[str, float], None]


def say(text: str) -> None:
    """Print one line as it is, however wide the terminal."""
    OUT.print(text, highlight=False, soft_wrap=True)


def remark(text: str, style: str | None = None) -> None:
    """Print one line on standard error, beside the result."""
    ERRORS.print(text, style=style, highlight=False, soft_wrap=True)


def note(text: str) -> None:
    """Print what a user should know on standard error."""
    remark(f"note: {text}", "yellow")


def print_error(error: BaseException) -> None:
    """Print an error as one line on standard error; of an error of the system the file comes first."""
    text = str(error)
    if isinstance(error, OSError) and error.filename is not None and error.strerror:
        text = f"{error.filename}: {error.strerror}; see that it is there and may be used, or give another"
    elif isinstance(error, OSError) and error.errno == errno.ENOSPC:
        text = f"{error.strerror}: where the output goes, or in a temporary folder; make room"
    remark(f"tactable: {text}", "red")


def print_json(value: object, indent: int | None = 2) -> None:
    """Print JSON as it is; without indent it is one line."""
    print(json.dumps(value, indent=indent), flush=True)  # noqa: T201


def show(result: _Result, as_json: bool, print_page: Callable[[Console, _Result], None]) -> None:
    """Print a result as JSON, or as the page that `print_page` makes of it."""
    if as_json:
        print_json(result)
    else:
        print_page(OUT, result)


@contextmanager
def shown_work(what: str, is_hidden: bool) -> Iterator[None]:
    """Show what is being done, and for how long, where there is a terminal and no fraction to tell."""
    from rich.progress import Progress as Line
    from rich.progress import SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Line(*columns, console=ERRORS, transient=True, disable=is_hidden or not ERRORS.is_terminal) as line:
        line.add_task(what, total=None)
        yield


@contextmanager
def shown_progress(is_hidden: bool) -> Iterator[Progress]:
    """A function that takes the present step and the fraction done, and shows a bar where there is a terminal."""
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    columns = (TextColumn("{task.description:>16}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Bar(*columns, console=ERRORS, transient=True, disable=is_hidden or not ERRORS.is_terminal) as bar:
        task = bar.add_task("starting", total=1.0)
        yield lambda step, fraction: bar.update(task, description=step, completed=fraction)
