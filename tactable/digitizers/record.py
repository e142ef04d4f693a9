"""Opens a digitizer by name, records its reports, and waits for the strokes that tell how it lies on the surface."""

import math
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from types import FrameType

from engine.loop.loop import Clock, StopRequest, SystemClock
from engine.touch import DescriptorError, Digitizer, DigitizerError, TouchFrame, open_digitizer
from engine.touch.sources import Source
from engine.touch.sources.evdev import open_evdev
from engine.touch.sources.hid_discovery import split_surface, undecodable
from engine.touch.sources.hidraw import HidrawSource, open_hidraw
from engine.touch.sources.recording import Playback, Recording, Report, read_recording
from tactable.digitizers.axis_map import LearntAxis, learn
from tactable.digitizers.listing import SIMULATED
from tactable.doctor.touch_check import Machine
from tactable.shipped import DEMO_RECORDING

_EVDEV_FOLDER = "/dev/input/"
_NS_PER_S = 1_000_000_000
_LONGEST_WAIT_NS = 100_000_000  # a stop is noticed within it


@contextmanager
def opened(machine: Machine, name: str) -> Iterator[tuple[Source, int]]:
    """Open a source by its name; yields it with the kernel's number of its bus. An unplug ends the source."""
    if name == SIMULATED:
        recording = read_recording(DEMO_RECORDING)
        yield Playback(recording), recording.bus
    elif name.startswith(_EVDEV_FOLDER):
        with closing(open_evdev(name, machine.evdev())) as source:
            yield source, 0
    else:
        with closing(open_hidraw(machine.hid(), name, reconnect=False)) as hidraw:
            yield hidraw, hidraw.device.bus


def open_live(machine: Machine, source: Source) -> Digitizer:
    """The digitizer of a source. Raises `DigitizerError`, which names what works instead, and `DescriptorError`."""
    try:
        return open_digitizer(source.descriptor, source.vendor_id, source.product_id, source.report_id)
    except (DescriptorError, DigitizerError) as error:
        if not isinstance(source, HidrawSource):
            raise
        raise undecodable(machine.hid(), source.device, error) from error


def recording_named(name: str) -> tuple[Path, int | None] | None:
    """The recording of a path, and the report ID of a touch surface behind a `#`; None where there is no such file."""
    path = name.rpartition("#")[0]
    if Path(name).is_file():
        return Path(name), None
    return (Path(path), split_surface(name)[1]) if path and Path(path).is_file() else None


def wait_for_reports(source: Source, clock: Clock, stop: StopRequest) -> Iterator[bytes | None]:
    """Yield each report as it comes, and None when no report waits, until the source ends or `stop` is set."""
    while not (source.ended or stop.is_set()):
        now_ns = clock.now_ns()
        report = source.read(now_ns)
        yield report
        if report is None:
            due_ns, descriptor = source.next_time_ns(), source.fileno()
            until_ns = now_ns + _LONGEST_WAIT_NS
            readable = () if descriptor is None or source.ended else (descriptor,)
            clock.wait(until_ns if due_ns is None else min(due_ns, until_ns), readable, ())


def record_source(source: Source, bus: int, clock: Clock, stop: StopRequest, seconds: float = math.inf) -> Recording:
    """Record a source for at most `seconds`; times count from its first report."""
    reports: list[Report] = []
    start_ns, first_ns = clock.now_ns(), 0
    for data in wait_for_reports(source, clock, stop):
        if data is not None:
            first_ns = first_ns if reports else source.report_time_ns
            # The form has microseconds.
            time_s = round((source.report_time_ns - first_ns) / 1000) / 1e6
            reports.append(Report(len(reports), time_s, data))
        if clock.now_ns() - start_ns >= seconds * _NS_PER_S:
            break
    return Recording(source.name, bus, source.vendor_id, source.product_id, source.descriptor, tuple(reports))


def learn_from_recording(path: Path, sides_mm: Sequence[float | None], report_id: int | None = None) -> LearntAxis:
    """Learn how the digitizer, or its surface with that report, lies on the surface from the longest strokes."""
    recording = read_recording(path)
    digitizer = open_digitizer(recording.descriptor, recording.vendor_id, recording.product_id, report_id)
    return learn(digitizer, (frame for _, frame in recorded_frames(digitizer, recording)), sides_mm)


def learn_live(
    machine: Machine, name: str, sides_mm: Sequence[float | None], on_foreign: Callable[[str], None]
) -> LearntAxis:
    """Learn how the digitizer lies from strokes that are drawn now; `on_foreign` as `Digitizer` has it."""
    with opened(machine, name) as (source, _), stop_at_signal() as stop:
        digitizer = open_live(machine, source)
        digitizer.on_foreign = on_foreign
        return learn(digitizer, _live_frames(source, digitizer, SystemClock(), stop), sides_mm, is_live=True)


def recorded_frames(digitizer: Digitizer, recording: Recording) -> Iterator[tuple[int | None, TouchFrame]]:
    """Each frame of a recording with the index of its report; None: time brought it, as in the engine."""
    reports = [(report.index, round(report.time_s * _NS_PER_S), report.data) for report in recording.reports]
    for index, time_ns, data in [*reports, (0, None, b"")]:
        while (due_ns := digitizer.due_ns) is not None and (time_ns is None or due_ns <= time_ns):
            frame = digitizer.expire(due_ns)
            if frame is not None:
                yield None, frame
        frame = None if time_ns is None else digitizer.decode_report(data, time_ns)
        if frame is not None:
            yield index, frame


def _live_frames(source: Source, digitizer: Digitizer, clock: Clock, stop: StopRequest) -> Iterator[TouchFrame]:
    for report in wait_for_reports(source, clock, stop):
        expired = digitizer.expire(source.source_time_ns(clock.now_ns()))
        decoded = None if report is None else digitizer.decode_report(report, source.report_time_ns)
        yield from filter(None, (expired, decoded))


@contextmanager
def stop_at_signal() -> Iterator[threading.Event]:
    """An event that SIGINT and SIGTERM set, in place of an exception in the middle of a report."""
    stop = threading.Event()

    def set_stop(_number: int, _frame: FrameType | None) -> None:
        stop.set()

    before = {number: signal.signal(number, set_stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
