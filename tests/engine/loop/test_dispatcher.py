"""Laws of the outgoing half: at most one command waits, the latest wins, and each has one fate."""

from engine.loop.dispatcher import Dispatcher
from engine.loop.observer import CommandRecord, Fate, LoopCounters, Observers, Timing, Trace
from engine.render.link_commands import SILENCE, Command, DriveCommand
from tests.engine.loop.rig import Rig, recording_of, report
from tests.tools.virtual import MS

LOUD, SOFT = (DriveCommand(bytes([60, 0, level, 0, 0, 0] * 2)) for level in (200, 100))


class Desk:
    """A dispatcher on the rig's ready link, whose time passes by hand."""

    def __init__(self) -> None:
        self.rig = Rig(recording_of((0.0, report())))
        self.rig.line.clock.time_ns += 50 * MS  # the handshake has left the line
        self.dispatcher = Dispatcher(self.rig.session, self.rig.line.now_ns)

    def hand_over(self, command: Command, index: int | None = 0) -> Fate:
        fate = self.dispatcher.hand_over(command)
        stamps = (1, 2, 3, 4, 5, 0)
        record = CommandRecord(stamps, index, b"report", None, None, None, False, (), b"", fate, None)
        self.dispatcher.note(record)
        return fate

    def send(self) -> None:
        self.rig.line.clock.time_ns += 50 * MS
        self.rig.session.send()
        self.dispatcher.settle_if_written()

    def fates(self) -> list[Fate]:
        return [record.fate for record in self.dispatcher.take_records()]


def test_a_command_is_written_once_and_the_same_again_is_not_sent() -> None:
    desk = Desk()
    assert desk.hand_over(LOUD) is Fate.WAITING
    desk.send()
    (written,) = desk.dispatcher.take_records()
    assert (written.fate, written.drive_sequence) == (Fate.WRITTEN, desk.rig.session.link.drive_sequence)
    assert written.stamps_ns == (1, 2, 3, 4, 5, desk.rig.line.time_ns)
    assert desk.hand_over(LOUD) is Fate.SAME
    assert desk.fates() == [Fate.SAME]
    assert (desk.dispatcher.counters.commands, desk.dispatcher.counters.state_changes) == (1, 2)


def test_the_latest_of_several_commands_wins() -> None:
    desk = Desk()
    for command in (LOUD, SOFT, LOUD):
        desk.hand_over(command)
    desk.send()
    assert desk.fates() == [Fate.DROPPED, Fate.DROPPED, Fate.WRITTEN]
    assert desk.dispatcher.held == LOUD


def test_a_command_that_waits_is_told_again_without_its_report_when_it_has_left() -> None:
    desk, trace, timing = Desk(), Trace(), Timing()
    observers = Observers(trace, None, timing)
    desk.hand_over(LOUD)
    (waiting,) = desk.dispatcher.take_records()
    desk.send()
    (written,) = desk.dispatcher.take_records()
    assert (waiting.fate, waiting.report) == (Fate.WAITING, b"report")
    assert (written.fate, written.report, written.report_index) == (Fate.WRITTEN, b"", 0)
    for record in (waiting, written):
        observers.observe(record, LoopCounters())
    assert list(trace) == [written]
    assert timing.latency.count == 1


def test_silence_equals_what_a_fresh_session_holds() -> None:
    desk = Desk()
    assert desk.hand_over(SILENCE) is Fate.SAME
    assert not desk.dispatcher.is_pending
