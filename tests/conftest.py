"""What all tests share: examples may take as long as a busy machine needs, and BLAS runs on one thread."""

import ctypes
import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings
from threadpoolctl import threadpool_limits

from engine.loop.fast.library import FastPathError, compile_fast_path, open_fast_path

# Consoles made with it would keep that width, whatever a test says.
os.environ.pop("COLUMNS", None)
settings.register_profile("tactable", deadline=None)
settings.load_profile("tactable")


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
