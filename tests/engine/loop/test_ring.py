"""Laws of what is kept of a run: a ring that any number of readers read, stamps and their percentiles, scan times."""

import errno
import math
import os
from itertools import islice, pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from engine.loop.observer import LatencyRecorder, Percentiles, ScanTimes, Stamps
from engine.loop.ring import MOST_TOUCHES, Record, RingCounters, RingError, RingReader, RingWriter
from engine.touch import Placement, Touch
from engine.touch.placement import MOST_FINGERS
from tests.engine.loop.rig import observe

words = st.integers(-(2**63), 2**63 - 1)
counts = st.integers(0, 2**64 - 1)
touches = st.builds(
    Touch, words, st.floats(allow_nan=False, allow_infinity=False), st.one_of(st.none(), st.integers(0, 9))
)
positions = st.floats(0, 1, allow_subnormal=True)
placements = st.lists(st.tuples(positions, st.booleans()), min_size=1, max_size=MOST_FINGERS).map(
    lambda fingers: Placement(tuple(at_m for at_m, _ in fingers), tuple(is_felt for _, is_felt in fingers))
)
records = st.builds(
    Record,
    stamps_ns=st.tuples(*(words,) * 6),
    report_index=st.one_of(st.none(), st.integers(0, 2**62)),
    placement=st.none() | placements,
    level_db=st.one_of(st.none(), st.floats(0, 60), st.just(math.inf)),
    is_click=st.booleans(),
    drive_sequence=st.one_of(st.none(), st.integers(0, 255)),
    counters=st.builds(RingCounters, *(counts,) * 6),
    touches=st.lists(touches, max_size=MOST_TOUCHES).map(tuple),
    drive=st.binary(max_size=96),
    report=st.binary(max_size=256),
    play=st.binary(max_size=200),
    effect=st.text(max_size=16),
)
PLAIN = Record((1, 2, 3, 4, 5, 6), 0, None, None, False, None, RingCounters(0, 0, 0, 0, 0, 0), (), b"", b"")


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "ring"


@given(st.lists(records, max_size=20), st.integers(1, 8))
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_the_latest_records_come_back_and_the_others_are_counted(path: Path, written: list[Record], slots: int) -> None:
    with RingWriter(path, slots) as writer, RingReader(path) as reader:
        for record in written:
            observe(writer, record)
        assert list(reader.read()) == written[-slots:]
        assert reader.lost == max(0, len(written) - slots)
        assert list(reader.read()) == []


def test_each_reader_has_its_own_place_and_goes_only_forward(path: Path) -> None:
    with RingWriter(path, 4) as writer, RingReader(path) as early:
        observe(writer, PLAIN)
        with RingReader(path) as late, RingReader(path, from_start=True) as whole, RingReader(path) as skipping:
            observe(writer, PLAIN)
            observe(writer, PLAIN)
            skipping.skip_to(2)
            assert [len(list(reader.read())) for reader in (early, late, whole, skipping)] == [3, 2, 3, 1]
            skipping.skip_to(1)
            assert list(skipping.read()) == []


def test_more_touches_than_fit_and_a_longer_report_are_cut(path: Path) -> None:
    many = tuple(Touch(number, 0.1, 1) for number in range(MOST_TOUCHES + 3))
    with RingWriter(path) as writer, RingReader(path) as reader:
        observe(writer, PLAIN._replace(touches=many, report=bytes(range(256)) * 8))
        (record,) = reader.read()
    assert record.touches == many[:MOST_TOUCHES]
    assert (bytes(range(256)) * 8).startswith(record.report)


def test_a_record_that_is_being_overwritten_is_not_believed(path: Path) -> None:
    with RingWriter(path) as writer, RingReader(path) as reader:
        observe(writer, PLAIN)
        with path.open("r+b") as file:
            file.seek(100)  # in the first record's stamps
            file.write(b"\xff")
        assert list(reader.read()) == []
        assert reader.lost == 1


def test_a_full_disk_is_named_and_leaves_no_ring(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fill(_descriptor: int, _at: int, _size: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "posix_fallocate", fill)
    with pytest.raises(RingError, match=rf"{path}: no ring of \d+ bytes .*No space left.*: make room"):
        RingWriter(path)
    assert not path.exists()


def test_the_ring_goes_with_its_writer_and_a_second_one_is_refused(path: Path) -> None:
    with RingWriter(path), pytest.raises(RingError, match="no ring can be made there"):
        RingWriter(path)
    assert not path.exists()
    with pytest.raises(RingError, match="there is no ring"):
        RingReader(path)


@pytest.mark.parametrize(("head", "said"), [(b"x" * 64, "is no ring"), (b"tactring" + b"\x01" * 56, "of revision")])
def test_what_is_no_ring_of_ours_is_refused_by_name(path: Path, head: bytes, said: str) -> None:
    path.write_bytes(head)
    with pytest.raises(RingError, match=said):
        RingReader(path)


@given(st.lists(st.tuples(st.integers(0, 12), st.integers(0, 12)), max_size=20))
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_reader_that_is_overtaken_sees_whole_records_in_order(path: Path, turns: list[tuple[int, int]]) -> None:
    number, indices = 0, list[int]()
    with RingWriter(path, 8) as writer, RingReader(path) as reader:
        reading = reader.read()
        for written, read in [*turns, (1, 0), (0, 100)]:
            for _ in range(written):
                observe(writer, PLAIN._replace(stamps_ns=(number,) * 6, report_index=number))
                number += 1
            for record in islice(reading, read):
                assert record.report_index is not None and set(record.stamps_ns) == {record.report_index}
                indices.append(record.report_index)
            reading = reader.read()
        assert all(later > earlier for earlier, later in pairwise(indices))
        assert (len(indices) + reader.lost, indices[-1]) == (number, number - 1)


stamps = st.tuples(*(st.integers(0, 2**62),) * 6)


@given(st.lists(stamps, max_size=20), st.integers(1, 8))
def test_the_latest_are_kept_in_order_and_all_are_counted(rows: list[Stamps], capacity: int) -> None:
    recorder = LatencyRecorder(capacity)
    for row in rows:
        recorder.record(*row)
    assert recorder.count == len(rows)
    assert recorder.rows_ns().tolist() == [list(row) for row in rows[-capacity:]]


@given(st.lists(st.integers(0, 10**9), min_size=1, max_size=200))
def test_a_percentile_is_the_least_sample_that_its_share_stays_within(durations_ns: list[int]) -> None:
    recorder = LatencyRecorder()
    for duration_ns in durations_ns:
        recorder.record(5, 6, 7, 8, 9, 5 + duration_ns)
    summary = recorder.summarise()
    assert summary is not None
    assert summary == Percentiles.of([*map(float, durations_ns), np.nan])
    shares = {
        0.1: summary.p10_ns,
        0.5: summary.p50_ns,
        0.9: summary.p90_ns,
        0.99: summary.p99_ns,
        0.999: summary.p99_9_ns,
        0.9999: summary.p99_99_ns,
    }
    for share, percentile_ns in shares.items():
        assert percentile_ns in durations_ns
        assert np.mean([duration_ns <= percentile_ns for duration_ns in durations_ns]) >= share
        assert np.mean([duration_ns < percentile_ns for duration_ns in durations_ns]) < share
    assert summary.max_ns == max(durations_ns)
    assert summary.count == len(durations_ns)


def times(count: int, tick_ns: float, late_ns: np.ndarray[tuple[int], np.dtype[np.float64]]) -> ScanTimes:
    """A device of 8 ms whose 100 us take `tick_ns`, behind a host that is late."""
    kept = ScanTimes(capacity=400)
    for index in range(count):
        scan_ns = 80 * 100_000 * index
        kept.record(round(80 * tick_ns * index + late_ns[index]), scan_ns)
    return kept


@pytest.mark.parametrize("count", [100, 400, 1000])
@pytest.mark.parametrize("tick_ns", [92_000.0, 100_000.0, 131_000.0])
def test_a_punctual_host_shows_the_device_alone(count: int, tick_ns: float) -> None:
    found = times(count, tick_ns, np.zeros(count)).summarise()
    assert found is not None
    assert found.period_ns == pytest.approx(80 * tick_ns, rel=1e-6)
    assert found.jitter_p99_ns < 1_000


def test_few_frames_say_nothing() -> None:
    assert times(50, 100_000.0, np.zeros(50)).summarise() is None
    assert ScanTimes().summarise() is None
