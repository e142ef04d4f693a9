"""Cases of a test: a few are tried each time somebody runs `pytest`, the others with the long tests."""

from collections.abc import Iterable
from typing import Any

import pytest


def first_quick(cases: Iterable[Any], count: int = 1) -> list[Any]:
    """A test parameter per case: the first `count` as they are, the others marked `long`."""
    return [pytest.param(case, marks=() if i < count else pytest.mark.long) for i, case in enumerate(cases)]
