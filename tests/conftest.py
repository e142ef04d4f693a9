"""What all tests share: examples may take as long as a busy machine needs, and BLAS runs on one thread."""

from collections.abc import Iterator

import pytest
from hypothesis import settings
from threadpoolctl import threadpool_limits

settings.register_profile("tactable", deadline=None)
settings.load_profile("tactable")


@pytest.fixture(autouse=True, scope="session")
def one_blas_thread() -> Iterator[None]:
    """Unpinned, BLAS costs 100 times on a busy machine."""
    with threadpool_limits(1, "blas"):
        yield
