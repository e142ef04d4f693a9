"""A pytest plugin: a test that is not marked `machine` fails by name if it uses the machine that it runs on.

A law that starts a process, opens a port or a pseudo-terminal, sets a timer, or waits for a time on the real clock
fails where the machine stands still, whatever it tests. Python tells of processes, sockets and signals by audit events;
calls that have none are wrapped. A C library that is compiled because the cache has none is no use, as numba's kernels
are none, nor is what a library does while it is imported: any test can be the first that needs it. What a fixture of a
module or a session uses counts for every test that asks for it, so that the order of the tests decides nothing.
`--list-unquiet FILE` lists what was used, in place of failing.
"""

import functools
import multiprocessing.util
import os
import select
import selectors
import signal
import sys
import threading
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

ROOT = f"{Path(__file__).parents[2]}{os.sep}"
LIBRARIES = sys.prefix
KIND_OF_EVENT = {
    **dict.fromkeys(("subprocess.Popen", "os.posix_spawn", "os.fork", "os.forkpty", "os.system"), "process"),
    **dict.fromkeys(("socket.bind", "socket.connect", "socket.sendto"), "socket"),
    **dict.fromkeys(("os.kill", "signal.pthread_kill"), "signal"),
}
COMPILES = f"{ROOT}base/c_library.py"
IMPORTS = "<frozen importlib._bootstrap>"
_is_allowed = ContextVar("_is_allowed", default=False)
_uses: set[str] = set()
"""What the running phase of a test or fixture used: "process at base/files.py:12"."""
_uses_of_fixtures: dict[object, set[str]] = {}


@contextmanager
def allowed(reason: str) -> Iterator[None]:
    """What the block uses of the machine is no law's business, for the reason given: such as a compiler."""
    assert reason
    token = _is_allowed.set(True)
    try:
        yield
    finally:
        _is_allowed.reset(token)


def _note(kind: str) -> None:
    """Note the use with the innermost line of the project that leads to it; what a library does by itself is no use."""
    if _is_allowed.get():
        return
    frame: FrameType | None = sys._getframe(1)
    while frame is not None:
        file = frame.f_code.co_filename
        if file in (COMPILES, IMPORTS):
            return
        if file.startswith(ROOT) and not file.startswith(LIBRARIES) and file != __file__:
            _uses.add(f"{kind} at {file.removeprefix(ROOT)}:{frame.f_lineno}")
            return
        frame = frame.f_back


def _hear(event: str, args: tuple[Any, ...]) -> None:
    kind = KIND_OF_EVENT.get(event)
    if kind and not (kind == "signal" and args[1] == 0):  # which asks whether a process is there
        _note(kind)


def _wrap(owner: Any, name: str, kind: str, counts: Callable[..., bool] = lambda *_, **__: True) -> None:
    """Note each call of a function that has no audit event."""
    function = getattr(owner, name)

    @functools.wraps(function)
    def noting(*args: Any, **kwargs: Any) -> Any:
        if counts(*args, **kwargs):
            _note(kind)
        return function(*args, **kwargs)

    setattr(owner, name, noting)


def _has_timeout(_: object, timeout: float | None = None) -> bool:
    return timeout is not None and timeout > 0


def _watch_process() -> None:
    """Once a process: an audit hook cannot be taken back."""
    sys.addaudithook(_hear)
    _wrap(time, "sleep", "sleep", lambda seconds: seconds > 0)
    _wrap(os, "openpty", "pseudo-terminal")
    _wrap(multiprocessing.util, "spawnv_passfds", "process")
    for name in "setitimer", "alarm":
        _wrap(signal, name, "timer")
    _wrap(threading.Thread, "join", "wait", _has_timeout)
    _wrap(threading.Condition, "wait", "wait", _has_timeout)
    _wrap(select, "select", "wait", lambda _r, _w, _x, timeout=None: _has_timeout(None, timeout))
    for selector in selectors.SelectSelector, selectors.PollSelector, selectors.EpollSelector:
        _wrap(selector, "select", "wait", _has_timeout)


def pytest_addoption(parser: pytest.Parser) -> None:
    """`--list-unquiet FILE`: which tests would need a quiet machine."""
    parser.addoption("--list-unquiet", help="append what tests use of the machine to this file, in place of failing")


def pytest_configure() -> None:
    """Watch this process."""
    if not hasattr(sys, "_tactable_is_watched"):
        sys._tactable_is_watched = True  # type: ignore[attr-defined]
        _watch_process()


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup(fixturedef: pytest.FixtureDef[Any]) -> Generator[None, object, object]:
    """Keep what a fixture uses, for all tests that will ask for it."""
    before = set(_uses)
    _uses.clear()
    try:
        return (yield)
    finally:
        _uses_of_fixtures[fixturedef] = set(_uses)
        _uses.update(before)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup() -> None:
    """A test begins with nothing used."""
    _uses.clear()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Fail the test for what it and its fixtures used: when it was called, or when what it used was put away."""
    report = yield
    if call.when == "setup" and report.passed:
        return report
    used = set(_uses)
    _uses.clear()
    if call.when == "call":
        used.update(*(_uses_of_fixtures.get(each, ()) for each in _fixtures(item)))
    if not used or item.get_closest_marker("machine"):
        return report
    if listed := item.config.getoption("--list-unquiet"):
        with Path(listed).open("a", encoding="utf-8") as file:
            file.writelines(f"{item.nodeid}\t{use}\n" for use in sorted(used))
    elif report.passed:
        report.outcome = "failed"
        uses = ", ".join(sorted(used))
        report.longrepr = f"{item.nodeid} uses the machine: {uses}. Mark it machine, or give it virtual time."
    return report


def _fixtures(item: pytest.Item) -> Iterator[object]:
    """Every fixture that the test may have asked for."""
    for definitions in getattr(getattr(item, "_fixtureinfo", None), "name2fixturedefs", {}).values():
        yield from definitions
