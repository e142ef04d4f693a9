"""Child process that compiles kernels for the page, then builds its tables: one with few places first.

Numba compiles a kernel with a declared signature when its module is imported, and keeps it in a cache; later imports
load it in milliseconds. So a process that must not wait imports none of these modules until this one has. Kernels of
clicks come first, since steady drives can do without for a while (`engine.steady.plain_solver`), and no click can. They
have no declared signature: the first click compiles them, and a device without any table gets it; the page solves the
others as fingers ask for them. Then come those of steady drives, and those of builds.
"""

import os
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from base.child import Parent
from base.files import rename_durably
from tactable.rig.ready import early_options, early_path, open_cached, solve_first_click, write_first_table
from tactable.shipped import find_device

STEADY = (
    "engine.steady.forms",
    "engine.steady.optimum",
    "engine.steady.limited",
    "engine.steady.ascent",
    "engine.steady.loading",
    "engine.steady.drive_search",
)
"""What steady drives at any positions take."""
SWEEP = ("precompute.model.band_solver", "precompute.model.gram", "precompute.sweep.sweep_kernels")
"""What the rows of a sweep take, which zones play."""
BUILDS = ("precompute.predict.rise_time",)  # what builds take beside that
_FIRST_CLICK = "the first click"
_ALL = (_FIRST_CLICK, *STEADY, *SWEEP, *BUILDS)
_HEAD_START_S = 3.0
"""The page changes over to the table with the first click in this time, and starts what solves the others."""


@dataclass(frozen=True)
class BuildOrder:
    """A table to build."""

    device: str
    path: Path
    first: Path  # where the table with the first click is put; where the page has another table, it is not made


def build(order: BuildOrder, parent: Parent) -> None:
    """Build it, unless it is there; kernels come first.

    Says {"step", "fraction"} as it goes on, {"compiled": true} once those that play takes are, and {"usable": path} for
    each usable table.
    """
    device, early = find_device(order.device), early_path(order.path)
    _say_module(parent, _FIRST_CLICK)
    clicks = solve_first_click(device)
    found = open_cached(device, order.path)
    if found is None:
        write_first_table(device, order.first, clicks)
        parent.say({"usable": str(order.first)})
        time.sleep(_HEAD_START_S)
    _compile(parent, (*STEADY, *SWEEP))
    parent.say({"compiled": True})
    _compile(parent, BUILDS)
    if found is not None and found.path == order.path:
        parent.say({"usable": str(order.path)})
        return
    from precompute.builder.table_build import build_table
    from precompute.parallel.pool import available_cores

    def progress(step: str, fraction: float) -> None:
        parent.say({"step": step, "fraction": fraction})

    order.path.parent.mkdir(parents=True, exist_ok=True)
    with _sigterm_as_interrupt():
        workers = available_cores()
        build_table(device, early, click_options=early_options(), workers=workers, progress=progress)
        parent.say({"usable": str(early)})
        build_table(device, early, completes=True, workers=workers, progress=progress)
    rename_durably(early, order.path)
    parent.say({"usable": str(order.path)})


def _compile(parent: Parent, modules: Sequence[str]) -> None:
    """Compile the kernels of these modules, of the lists above."""
    for module in modules:
        _say_module(parent, module)
        import_module(module)


def _say_module(parent: Parent, module: str) -> None:
    before, count = _ALL.index(module), len(_ALL)
    parent.say({"step": f"compiling {module}, {before + 1} of {count}", "fraction": before / count})


@contextmanager
def _sigterm_as_interrupt() -> Iterator[None]:
    """SIGTERM is Ctrl-C, which a build remembers; before and after, when nothing can be lost, it ends the process."""
    sys.unraisablehook = _tell_all_but_interrupts
    signal.signal(signal.SIGTERM, lambda *_: signal.raise_signal(signal.SIGINT))
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _tell_all_but_interrupts(ignored: Any) -> None:
    """An interrupt that comes up within a finalizer is remembered, and nothing to tell."""
    if ignored.exc_type is not KeyboardInterrupt:
        sys.__unraisablehook__(ignored)


def main(parent: Parent, arguments: dict[str, Any]) -> None:
    """Build the order; SIGTERM keeps the finished clicks for the next build."""
    parent.end_with_it()
    os.nice(10)  # the page comes first
    try:
        build(arguments["order"], parent)
    except KeyboardInterrupt:
        raise SystemExit(1) from None
