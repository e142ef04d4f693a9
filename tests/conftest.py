"""What all tests share: examples may take as long as a busy machine needs, BLAS runs on one thread, and one order."""

import ctypes
import fcntl
import gc
import os
import random
import signal
from collections.abc import Generator, Iterator
from contextlib import suppress
from importlib import import_module
from pathlib import Path

import pytest
from hypothesis import settings
from threadpoolctl import threadpool_limits

from engine.loop.fast.library import FastPathError, compile_fast_path, open_fast_path
from tests.tools.once import once_a_run

pytest_plugins = ("pytester", "tests.tools.guard", "tests.tools.verdict")

# Consoles made with it would keep that width, whatever a test says.
os.environ.pop("COLUMNS", None)
# Processes that tests start would compile all of Python's modules again.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
EXAMPLES = 20
"""Of Hypothesis for a law: a check has the same ones each time, an order seed draws others."""

ROOT = Path(__file__).parents[1]
SLOWEST = (
    "tests/test_docs.py",
    "tests/test_notebooks.py",
    "tests/precompute/calibration/test_adequacy.py",
    "tests/precompute/calibration/test_measured_bars.py",
    "tests/tactable/track/test_tracked_run.py",
    "tests/tactable/calibration/test_apply.py",
    "tests/system/test_compiled_step.py",
    "tests/system/test_fleet.py",
    "tests/firmware_link/firmware/test_core.py",
    "tests/precompute/calibration/test_conventions.py",
    "tests/tactable/rig/test_demo_run.py",
    "tests/tactable/rig/test_ready.py",
    "tests/precompute/calibration/test_on_a_plate.py",
    "tests/precompute/clicks/test_closed_form.py",
    "tests/tactable/page/test_live_backend.py",
    "tests/precompute/fleet/test_fleet_run.py",
    "tests/precompute/parallel/test_pool.py",
    "tests/tactable/measure/test_taps.py",
    "tests/tactable/experiment/test_report.py",
    "tests/studies/physics/test_steady_optimum.py",
    "tests/test_house.py",
    # Not while the browser of the page's tests is open: they keep time.
    "tests/system/test_guest.py",
    "tests/system/test_qemu_firmware.py",
)
"""Files that a run begins with, so that the workers end together."""
KERNELS = (
    *("engine.steady.drive_search", "engine.steady.loading", "precompute.model.band_solver", "precompute.model.gram"),
    *("precompute.sweep.sweep_kernels", "precompute.predict.rise_time"),
)
"""Modules that compile kernels when they are imported, unless numba's cache has them; each well after what it needs."""
ALLOWED_SKIPS = ("long run:", "no recordings:")
"""How the reason of a skip begins that `--no-skips` lets pass."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """`--no-skips`: what is missing fails a test in place of skipping it; `--order-seed`: another order."""
    parser.addoption("--no-skips", action="store_true", help="a test that skips fails, such as for a missing program")
    parser.addoption("--order-seed", type=int, help="run in a random order, with other examples of laws")


def pytest_configure(config: pytest.Config) -> None:
    """Choose the examples of Hypothesis, and share the compiling of kernels among the workers."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        # A shell tells the jobs that it runs in the background to ignore Ctrl-C, and what tests start would inherit it.
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if config.option.markexpr == "long":  # the tiers are disjoint: what needs the real machine is of no other
        config.option.markexpr = "long and not machine"
    is_search = config.getoption("--order-seed") is not None
    settings.register_profile("tier", deadline=None, max_examples=EXAMPLES, derandomize=not is_search)
    settings.load_profile("tier")
    has_all = config.args_source is config.ArgsSource.TESTPATHS
    if hasattr(config, "workerinput") or (has_all and not config.option.numprocesses):
        _compile_kernels()


def _compile_kernels() -> None:
    """With an empty cache each kernel is compiled by one process: others leave it out and read it afterwards."""
    for how in fcntl.LOCK_EX | fcntl.LOCK_NB, fcntl.LOCK_EX:
        for name in KERNELS:
            with ROOT.joinpath(*name.split(".")).with_suffix(".py").open() as lock, suppress(BlockingIOError):
                fcntl.flock(lock, how)
                import_module(name)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """The slowest files first; otherwise as collected, or as drawn from `--order-seed`."""
    if (seed := config.getoption("--order-seed")) is not None:
        source = random.Random(seed)
        places = {file: source.random() for file in dict.fromkeys(item.nodeid.partition("::")[0] for item in items)}
        source.shuffle(items)
        items.sort(key=lambda item: places[item.nodeid.partition("::")[0]])
        return
    rank = {name: number for number, name in enumerate(SLOWEST)}
    items.sort(key=lambda item: rank.get(item.nodeid.partition("::")[0], len(rank)))


def pytest_collection_finish() -> None:
    """Freeze what the imported modules made: the loop collects before each run, which took 0.3 s of every such test."""
    gc.collect()
    gc.freeze()


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


@pytest.fixture
def both_ends() -> Iterator[None]:
    """Allows sockets whose two ends this process holds: where it stands still, both do."""
    from tests.tools.guard import allowed  # pytest imports its plugins itself

    with allowed("both ends are in this process"):
        yield


@pytest.fixture(scope="session")
def fast_library(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    """The compiled step, or the one that TACTABLE_STEP_LIBRARY names; without a compiler tests are skipped by name."""
    if path := os.environ.get("TACTABLE_STEP_LIBRARY"):
        return open_fast_path(Path(path))
    try:
        return compile_fast_path(once_a_run(tmp_path_factory, "fast_path", compile_fast_path))
    except FastPathError as error:
        pytest.skip(str(error))
