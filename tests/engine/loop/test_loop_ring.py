"""The loop to its ring: what other processes see is what the trace, the latencies and the source say."""

from itertools import pairwise
from pathlib import Path

from engine.effects.rules import Effects
from engine.loop.ring import Record, RingReader, RingWriter
from tests.engine.loop.rig import BIT_RATE_HZ, BURSTS, HELD, Rig, held, recording_of, report

RUNS_BOTH_WAYS = True


def run_with_ring(
    path: Path, *frames: tuple[float, bytes], effects: Effects = HELD, bit_rate_hz: int = BIT_RATE_HZ
) -> tuple[Rig, list[Record]]:
    with RingWriter(path) as writer, RingReader(path) as reader:
        rig = Rig(recording_of(*frames), effects=effects, bit_rate_hz=bit_rate_hz, ring=writer).run()
        return rig, list(reader.read())


def test_the_ring_has_every_report_and_command_with_its_fingers_its_sequence_and_its_stamps(tmp_path: Path) -> None:
    frames = [*held(0.0, 0.1, (1, 0.1)), *held(0.1, 0.2, (1, 0.1), (2, 0.5)), (0.2, report(lifted=[1, 2]))]
    rig, records = run_with_ring(tmp_path / "ring", *frames)
    told = [(record.report_index, record.report) for record in records if record.report]
    assert told == [(r.index, r.data) for r in rig.recording.reports]
    assert all(later.time_ns >= earlier.time_ns for earlier, later in pairwise(records))
    sent = [record for record in records if record.drive_sequence is not None]
    changes = [change for change in rig.trace if change.drive_sequence is not None]
    assert [(r.report_index, r.placement, r.drive_sequence, r.touches) for r in sent] == [
        (c.report_index, c.placement, c.drive_sequence, tuple(c.touches)) for c in changes
    ]
    assert [touch.zone for touch in sent[1].touches] == [0, 2]
    assert [list(record.stamps_ns) for record in sent] == rig.latency.rows_ns().tolist()
    assert sent[-1].counters.commands == rig.loop.counters.commands


def test_what_time_alone_brings_is_told_too(tmp_path: Path) -> None:
    frames = [(0.0, report((1, 0.1))), (0.1, report(lifted=[1]))]
    rig, records = run_with_ring(tmp_path / "ring", *frames, effects=BURSTS)
    (ended,) = [record for record in records if record.report_index is None]
    assert (ended.placement, ended.level_db) == (rig.trace[1].placement, None)
    assert ended.drive == b""


def test_a_command_that_the_line_held_up_is_told_when_it_has_left(tmp_path: Path) -> None:
    places = [0.1, 0.3, 0.5, 0.7, 0.9]
    frames = [(0.0005 * i, report((1, place))) for i, place in enumerate(places)]
    rig, records = run_with_ring(tmp_path / "ring", *frames, *held(0.008, 0.1, (1, 0.9)), bit_rate_hz=115_200)
    told = [record.drive_sequence for record in records if record.drive_sequence is not None]
    assert told == [change.drive_sequence for change in rig.trace if change.drive_sequence is not None]
    assert records[-1].counters.replaced > 0
