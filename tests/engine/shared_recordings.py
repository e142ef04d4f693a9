"""The recordings beside the repository (../shared/recordings), which are not part of it: docs/results.md says why.

`touch/NAME.hid` are recordings in the form of hid-recorder. `golden/NAME.jsonl.gz` is what the kernel made of one,
played through a virtual device without its pauses: a line `{"file": "NAME.hid", "cols": [...], "abs": {...}}`, then
a line `[report index, [[time, [[slot, tracking id, x, y], ... of every contact]], ...]]` for each report
that ended a frame.
"""

from pathlib import Path

import pytest

RECORDINGS = Path(__file__).parents[3] / "shared" / "recordings"


def recording_params(folder: str, pattern: str, *, long_but: int | None = None) -> list[object]:
    """A test parameter per file, named by it; one that skips by name where the folder is absent.

    With `long_but` all but so many of them, taken evenly, are marked `long`.
    """
    paths = sorted((RECORDINGS / folder).glob(pattern))
    if not paths:
        skip = pytest.mark.skip(reason=f"no recordings: {RECORDINGS / folder} is absent")
        return [pytest.param(RECORDINGS / folder / pattern, id=f"{folder}-absent", marks=skip)]
    quick = paths if long_but is None else paths[:: -(-len(paths) // long_but)]
    return [
        pytest.param(path, id=path.name.split(".")[0], marks=() if path in quick else pytest.mark.long)
        for path in paths
    ]
