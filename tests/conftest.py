"""What all tests share: examples may take as long as a busy machine needs, BLAS runs on one thread, and one order."""

import ctypes
import os
from collections.abc import Generator, Iterator
from importlib import import_module
from pathlib import Path

import pytest
from hypothesis import settings
from threadpoolctl import threadpool_limits

from engine.loop.fast.library import FastPathError, compile_fast_path, open_fast_path

# Consoles made with it would keep that width, whatever a test says.
os.environ.pop("COLUMNS", None)
# Laws are searched by Hypothesis with few examples each time somebody runs `pytest`, and by five times as many with the
# long tests, as `.ci/run` does.
settings.register_profile("quick", deadline=None, max_examples=20)
settings.register_profile("long", deadline=None, max_examples=100)

SLOWEST = ("tests/test_house.py", "tests/tactable/rig/test_demo.py", "tests/test_docs.py", "tests/test_notebooks.py")
"""Files that a run begins with, so that the workers end together."""
KERNELS = ("engine.steady.search", "precompute.clicks.solver", "precompute.entries.solver", "precompute.sweep.kernels")
"""Modules that compile their kernels when they are imported, unless numba's cache has them."""
ALLOWED_SKIPS = ("long run:", "guided run:", "no recordings:")
"""How the reason of a skip begins that `--no-skips` lets pass."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """`--no-skips`: what is missing fails a test in place of skipping it."""
    parser.addoption("--no-skips", action="store_true", help="a test that skips fails, such as for a missing program")


def pytest_configure(config: pytest.Config) -> None:
    """Choose the examples of Hypothesis, and compile kernels in another order in each worker.

    So with an empty cache each worker compiles a part of the kernels.
    """
    settings.load_profile("quick" if "not long" in config.getoption("markexpr") else "long")
    worker = getattr(config, "workerinput", {}).get("workerid")
    if worker is not None:
        for name in KERNELS if worker == "gw0" else reversed(KERNELS):
            import_module(name)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The slowest files first; otherwise as collected."""
    rank = {name: number for number, name in enumerate(SLOWEST)}
    items.sort(key=lambda item: rank.get(item.nodeid.partition("::")[0], len(rank)))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """With `--no-skips`, a skip is a failure that names its reason."""
    report = yield
    if report.skipped and item.config.getoption("--no-skips"):
        reason = str(report.longrepr[2] if isinstance(report.longrepr, tuple) else report.longrepr)
        if not reason.removeprefix("Skipped: ").startswith(ALLOWED_SKIPS):
            report.outcome, report.longrepr = "failed", f"--no-skips: {reason}"
    return report


@pytest.fixture(autouse=True, scope="session")
def one_blas_thread() -> Iterator[None]:
    """Unpinned, BLAS costs 100 times on a busy machine."""
    with threadpool_limits(1, "blas"):
        yield


@pytest.fixture(scope="session")
def fast_library(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    """The compiled step, or the one that TACTABLE_STEP_LIBRARY names; without a compiler tests are skipped by name."""
    if path := os.environ.get("TACTABLE_STEP_LIBRARY"):
        return open_fast_path(Path(path))
    try:
        return compile_fast_path(Path(tmp_path_factory.mktemp("fast_path")))
    except FastPathError as error:
        pytest.skip(str(error))
