"""Work that takes a while to a bar with the time that is left, on standard error."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

_errors = Console(stderr=True)


@contextmanager
def shown_progress(quiet: bool) -> Iterator[Callable[[str, float], None]]:
    """A function to tell what is being done and the fraction done; without a terminal, or quiet, nothing is shown."""
    columns = (TextColumn("{task.description:>16}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, console=_errors, transient=True, disable=quiet or not _errors.is_terminal) as shown:
        task = shown.add_task("starting", total=1.0)
        yield lambda step, fraction: shown.update(task, description=step, completed=fraction)
