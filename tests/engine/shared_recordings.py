"""The recordings beside the repository (../shared/recordings), which are not part of it."""

from __future__ import annotations

from pathlib import Path

import pytest

RECORDINGS = Path(__file__).parents[3] / "shared" / "recordings"


def recording_params(folder: str, pattern: str) -> list[object]:
    """A test parameter per file, named by it; one that skips by name where the folder is absent."""
    paths = sorted((RECORDINGS / folder).glob(pattern))
    if not paths:
        skip = pytest.mark.skip(reason=f"{RECORDINGS / folder} is absent")
        return [pytest.param(RECORDINGS / folder / pattern, id=f"{folder}-absent", marks=skip)]
    return [pytest.param(path, id=path.name.split(".")[0]) for path in paths]
