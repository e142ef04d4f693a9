"""Programs that are compiled on the spot: how far apart two processors are, and what there is without them."""

import os
import shutil
from pathlib import Path

import pytest

from tactable.bench.latency.segments import build_program, exchange_ns

ALLOWED = sorted(os.sched_getaffinity(0))
NONE_SUCH = max(ALLOWED) + 1000


@pytest.mark.machine(stall_s=None)
@pytest.mark.skipif(not any(map(shutil.which, ("cc", "gcc", "clang"))), reason="there is no C compiler")
def test_an_exchange_takes_longer_than_a_cached_read_and_ends_where_a_processor_is_missing(tmp_path: Path) -> None:
    program = build_program("exchange", tmp_path)
    assert program is not None
    if len(ALLOWED) > 1:
        found_ns = exchange_ns(program, ALLOWED[0], ALLOWED[-1])
        assert found_ns is not None and found_ns > 5  # no processor's own cache takes longer for two reads
    assert exchange_ns(program, ALLOWED[0], NONE_SUCH) is None
    assert exchange_ns(program, NONE_SUCH, ALLOWED[0]) is None


def test_without_a_compiler_or_a_second_processor_there_is_no_figure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    assert build_program("exchange", tmp_path) is None
    assert exchange_ns(None, 0, 1) is None
    assert exchange_ns(tmp_path / "never run", 3, 3) is None
