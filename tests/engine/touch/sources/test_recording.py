"""Laws of the hid-recorder text form, and of a recording played as a source."""

import math
import os
import re
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from engine.touch import open_digitizer
from engine.touch.sources import Source
from engine.touch.sources.recording import (
    PAUSE_NS,
    Playback,
    Recording,
    RecordingError,
    Report,
    read_recording,
    write_recording,
)
from tests.engine.touch.descriptors import HYBRID
from tests.engine.touch.test_digitizer import NOBODY, Finger, hybrid

LINES = ("R: 2 05 0d", "N: bar", "I: 18 04f3 200a", "E: 000001.500000 3 01 02 ff")


def read_text(tmp_path: Path, text: str) -> Recording:
    path = tmp_path / "some.hid"
    path.write_bytes(text.encode())
    return read_recording(path)


reports = st.lists(st.tuples(st.integers(0, 10**12), st.binary(max_size=70)), max_size=5).map(
    lambda pairs: tuple(Report(index, time_us / 1e6, data) for index, (time_us, data) in enumerate(pairs))
)
names = st.text(st.characters(codec="utf-8", exclude_categories=("C", "Z")), max_size=20)
words = st.integers(0, 0xFFFF)
recordings = st.builds(Recording, names, words, words, words, st.binary(min_size=1, max_size=80), reports)


@given(recording=recordings)
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_what_is_written_is_read_back(tmp_path: Path, recording: Recording) -> None:
    path = tmp_path / "back.hid"
    write_recording(recording, path)
    assert read_recording(path) == recording
    assert list(tmp_path.iterdir()) == [path]


@given(text=st.text(st.sampled_from("RNIED:# 0189af.\r\n\x00é"), max_size=80))
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_text_is_a_recording_or_a_recording_error(tmp_path: Path, text: str) -> None:
    try:
        read_text(tmp_path, text)
    except RecordingError as error:
        assert "some.hid, line " in str(error)


def test_a_recording_is_read_field_by_field_whatever_its_line_ends_comments_and_blank_lines(tmp_path: Path) -> None:
    expected = Recording("bar", 0x18, 0x04F3, 0x200A, b"\x05\x0d", (Report(0, 1.5, b"\x01\x02\xff"),))
    noisy = "\r\n".join(f"# note: 1\r\n\r\n{line}" for line in LINES)
    assert read_text(tmp_path, "\n".join(LINES)) == read_text(tmp_path, noisy) == expected


def test_of_several_devices_the_first_is_read_and_its_reports_counted_also_without_a_name(tmp_path: Path) -> None:
    event = "E: 000000.000000 1"
    text = f"D: 0\nR: 1 05\nD: 1\nR: 1 06\nD: 0\n{event} aa\nD: 1\n{event} bb\nD: 0\n{event} cc\n"
    recording = read_text(tmp_path, text)
    assert (recording.name, recording.vendor_id, recording.descriptor) == ("", 0, b"\x05")
    assert [(report.index, report.data) for report in recording.reports] == [(0, b"\xaa"), (1, b"\xcc")]


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        ("E: 000000.000000 2 01", "length 2 but 1 bytes"),
        ("E: 000000.000000 1 0g", "pairs of hex digits"),
        ("E: 000000.000000", "a length, then bytes"),
        ("E: soon 1 00", "seconds.microseconds"),
        ("E: 0.5 1 00", "six digits"),
        ("I: 3 0596", "three hex numbers"),
        ("R: 1 05", "second report descriptor"),
    ],
)
def test_a_broken_line_is_named_with_its_number_and_remedy(tmp_path: Path, line: str, problem: str) -> None:
    with pytest.raises(RecordingError, match=problem) as caught:
        read_text(tmp_path, f"{LINES[0]}\n{line}\n")
    assert caught.value.line_number == 2


def test_a_file_without_descriptor_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="no report descriptor"):
        read_text(tmp_path, "N: bar\n")


def test_a_pipe_and_a_device_that_never_ends_are_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", Path("/dev/zero")):
        with pytest.raises(RecordingError, match="is not a plain file; write the recording into one"):
            read_recording(path)


PANEL = f"R: {len(HYBRID)} {HYBRID.hex(' ')}"
TOUCHES = [f"E: 000000.{8 * k:03d}000 14 {hybrid(Finger(1, 100 + k), NOBODY, 1).hex(' ')}" for k in range(3)]
EVDEV = [(3, 0x2F, 1), (3, 0x39, 7), (3, 0x35, 40), (3, 0x36, 9), (0, 0, 0), (3, 0x35, 41), (0, 0, 0), (3, 0x39, -1)]
RANGES = {0x2F: (0, 9), 0x35: (0, 1000), 0x36: (0, 100), 0x39: (0, 65535)}


def places(recording: Recording) -> list[list[tuple[int, int]]]:
    digitizer = open_digitizer(recording.descriptor, recording.vendor_id, recording.product_id)
    found = [digitizer.decode_report(report.data, round(1e9 * report.time_s)) for report in recording.reports]
    return [[(contact.x, contact.y) for contact in frame.contacts] for frame in found if frame is not None]


def folded(line: str) -> str:
    words, lines = line.split(" "), [""]
    for word in words:
        lines = [*lines, word] if len(lines[-1]) > 68 else [*lines[:-1], f"{lines[-1]} {word}".strip()]
    return "\n".join(lines)


@pytest.mark.parametrize(
    "mail", [folded, lambda line: f"> > {line}", lambda line: "=\n".join(re.findall(".{1,75}", line))]
)
def test_a_recording_that_went_through_mail_is_read_as_it_was(tmp_path: Path, mail: Callable[[str], str]) -> None:
    assert read_text(tmp_path, "\n".join(map(mail, (PANEL, *TOUCHES)))) == read_text(
        tmp_path, "\n".join((PANEL, *TOUCHES))
    )


def test_of_several_devices_the_touch_surface_is_read_wherever_it_stands(tmp_path: Path) -> None:
    mouse = "R: 4 05 01 09 02\nN: mouse\nE: 000000.000000 1 00"
    panel = "\n".join((PANEL, "N: panel", *TOUCHES))
    for text in (f"D: 0\n{mouse}\nD: 1\n{panel}", f"D: 1\n{panel}\nD: 0\n{mouse}"):
        recording = read_text(tmp_path, text)
        assert (recording.name, len(recording.reports)) == ("panel", 3)


def evemu(events: Sequence[tuple[int, int, int]]) -> str:
    axes = [f"A: {code:02x} {least} {most} 0 0 0" for code, (least, most) in RANGES.items()]
    lines = [f"E: 0.{k:06d} {kind:04x} {code:04x} {value:04d}\t# said" for k, (kind, code, value) in enumerate(events)]
    return "\n".join(["# EVEMU 1.3", "N: panel", "I: 0003 1234 0001 0110", *axes, *lines])


def libinput(events: Sequence[tuple[int, int, int]], hid: Sequence[bytes] = ()) -> str:
    head = ["devices:", "- node: /dev/input/event5", "  evdev:", '    name: "panel"', "    id: [3, 4660, 1, 0]"]
    codes = ["    codes:", "      0: [0, 1] # EV_SYN", "      3: [0, 47, 53] # EV_ABS", "    absinfo:"]
    axes = [f"      {code}: [{least}, {most}, 0, 0, 0]" for code, (least, most) in RANGES.items()]
    reports = [
        f"  - hid:\n    time: [  0, {k:6d}]\n    hidraw0: [\n  {listed(data)}\n    ]" for k, data in enumerate(hid)
    ]
    lines = [f"    - [  0, {k:6d}, {kind:3d}, {code:3d}, {value}]" for k, (kind, code, value) in enumerate(events)]
    return "\n".join([*head, *codes, *axes, f"  hid: [{listed(HYBRID)}]", "  events:", *reports, "  - evdev:", *lines])


def listed(data: bytes) -> str:
    return ",\n    ".join(", ".join(f"0x{byte:02x}" for byte in data[k : k + 16]) for k in range(0, len(data), 16))


@pytest.mark.parametrize("form", [evemu, libinput])
def test_events_of_the_input_layer_are_read_as_a_node_would_give_them(
    tmp_path: Path, form: Callable[[Sequence[tuple[int, int, int]]], str]
) -> None:
    recording = read_text(tmp_path, form([*EVDEV, (0, 0, 0)]))
    assert recording.name == "panel"
    assert places(recording) == [[(40, 9)], [(41, 9)], []]
    assert [report.time_s for report in recording.reports] == [4e-6, 6e-6, 8e-6]


def test_reports_that_libinput_kept_are_read_in_place_of_its_events(tmp_path: Path) -> None:
    recording = read_text(tmp_path, libinput(EVDEV, [hybrid(Finger(1, 100 + k), NOBODY, 1) for k in range(3)]))
    assert (recording.vendor_id, recording.product_id, recording.descriptor) == (0x1234, 1, HYBRID)
    assert places(recording) == [[(100, 200)], [(101, 200)], [(102, 200)]]


@pytest.mark.parametrize(
    ("text", "line", "says"),
    [
        (evemu(EVDEV).replace("A: 2f", "A: 2e"), 1, "multitouch slots.*hidraw"),
        (libinput(EVDEV).replace("47: [", "46: ["), 2, "multitouch slots.*hidraw"),
        (evemu(EVDEV).replace("A: 2f 0 9", "A: 2f 0 99999999"), 4, "A.*record again"),
        (evemu(EVDEV) + "\nE: 0.1 0003", 16, "E.*record again"),
        (libinput(EVDEV) + "\n    - [ 0, 9]", libinput(EVDEV).count("\n") + 2, r"\[ 0, 9\].*record again"),
        ("devices:\n", 1, "multitouch slots"),
    ],
)
def test_events_without_slots_or_cut_off_are_refused_by_line(tmp_path: Path, text: str, line: int, says: str) -> None:
    with pytest.raises(RecordingError, match=says) as caught:
        read_text(tmp_path, text)
    assert caught.value.line_number == line


START_NS = 10**15
speeds = st.none() | st.floats(0.01, 1000)
"""None: every report is due at once."""


@st.composite
def timed_recordings(draw: st.DrawFn) -> Recording:
    times_us = sorted(draw(st.lists(st.integers(0, 10**9), min_size=1, max_size=10)))
    reports = tuple(Report(index, time_us / 1e6, bytes([index])) for index, time_us in enumerate(times_us))
    return Recording("bar", 3, 0x04F3, 0x200A, b"\x05\x0d", reports)


@given(timed_recordings(), speeds)
def test_reports_come_at_their_pace_times_the_speed_with_their_times(recording: Recording, speed: float | None) -> None:
    """Each is read when it is due and never earlier."""
    source: Source = Playback(recording, speed)
    now_ns, first_s = START_NS, recording.reports[0].time_s
    for report in recording.reports:
        due_ns = source.next_time_ns()
        assert due_ns is not None and not source.ended
        if due_ns > now_ns:
            assert source.read(due_ns - 1) is None
        now_ns = max(now_ns, due_ns)
        assert source.read(now_ns) == report.data
        assert (source.report_index, source.report_time_ns) == (report.index, round(report.time_s * 1e9))
        pause_ns = 0 if speed is None else (report.time_s - first_s) * 1e9 / speed
        assert now_ns - START_NS == pytest.approx(pause_ns, rel=1e-9, abs=2)
    assert source.ended
    assert (source.read(now_ns + 10**12), source.next_time_ns()) == (None, None)


@given(timed_recordings(), speeds)
def test_what_is_repeated_goes_on_after_its_end_with_rising_times(recording: Recording, speed: float | None) -> None:
    source, now_ns, taken = Playback(recording, speed, repeats=True), START_NS, list[tuple[bytes, int]]()
    for _ in range(2 * len(recording.reports) + 1):
        due_ns = source.next_time_ns()
        assert due_ns is not None
        now_ns = max(now_ns, due_ns)
        report = source.read(now_ns)
        assert report is not None
        taken.append((report, source.report_time_ns))
    first = [report.data for report in recording.reports]
    assert [data for data, _ in taken] == [*first, *first, first[0]]
    gaps_ns = [after - before for (_, before), (_, after) in pairwise(taken)]
    assert min(gaps_ns) >= 0
    assert gaps_ns[len(first) - 1] == gaps_ns[2 * len(first) - 1] == PAUSE_NS
    assert not source.ended


@pytest.mark.parametrize("speed", [0.0, -1.0, math.inf, math.nan])
def test_a_speed_that_leads_nowhere_is_refused(speed: float) -> None:
    with pytest.raises(ValueError, match="expected a number above 0"):
        Playback(Recording("", 0, 0, 0, b"", ()), speed)
