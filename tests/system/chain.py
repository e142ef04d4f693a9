"""Touches of any source to any serial port, put together as the product does; in the guest, and beside it."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path

from engine.device import Device
from engine.effects.rules import Effect, Effects, Rule, Segment, Trigger
from engine.loop.dispatcher import Dispatcher
from engine.loop.loop import Loop, StopRequest, SystemClock, connect
from engine.loop.observer import CommandRecord, LoopCounters, Observers, Trace
from engine.loop.pipeline import open_pipeline
from engine.render.limits import link_configuration
from engine.touch.sources import Source
from firmware_link.emulator.drive_log import DriveEvent
from firmware_link.emulator.emulator_process import EmulatorLog
from firmware_link.host.link import Link
from firmware_link.host.link_values import LinkCounters
from firmware_link.host.serial_port import SerialPort
from firmware_link.host.session import Session
from firmware_link.protocol.link_errors import LinkError
from tests.engine.made_table import LEVEL_DB, state_index
from tests.engine.render.made_steady import made_renderer

DEVICE = Device.read(Path(__file__).parents[2] / "tables" / "devices" / "reference-a.toml")
BIT_RATE_HZ = 1_000_000
# Only against waiting for ever: the guest may be slow.
PATIENCE_S = 30.0
# A finger feels as long as it is there: each frame of states says which zones are touched.
HELD = Effects((Rule(Trigger.TOUCH, Effect("held", (Segment(None, LEVEL_DB),))),))


@dataclass(frozen=True)
class ChainRun:
    """What the engine did in one run, and how it ended: `link_error` is None for a run that ended as asked."""

    trace: tuple[CommandRecord, ...]
    counters: LoopCounters
    link_counters: LinkCounters
    link_error: str | None

    def states(self) -> list[int]:
        """The states rendered, in order, as if the machine had never stalled.

        A machine that stalls for 120 ms releases every contact, and the next report brings them back.
        """
        asked = [state_of(change) for change in self.trace if change.report_index is not None]
        return [state for state, _ in groupby(asked)]


class Taken:
    """Tells how many reports of a run were taken and answered."""

    def __init__(self, tell: Callable[[int], None]) -> None:
        self._tell = tell
        tell(0)

    def observe(self, record: CommandRecord, counters: LoopCounters) -> None:  # noqa: ARG002  # an Observer
        """Tell it at the end of the loop's pass."""
        self._tell(counters.reports)


def run_chain(
    source: Source,
    port: SerialPort,
    stop: StopRequest | None = None,
    on_ready: Callable[[], None] = lambda: None,
    on_taken: Callable[[int], None] = lambda _: None,
) -> ChainRun:
    """Greet the firmware, say so, then run until the source has ended or `stop` is set; closes the port.

    `on_taken` is told how many reports were answered.
    """
    clock, trace = SystemClock(), Trace()
    link = Link(replace(link_configuration(DEVICE, BIT_RATE_HZ), handshake_timeout_s=PATIENCE_S))
    link_error = None
    with port:
        session = Session(link, port, clock.now_ns)
        renderer = made_renderer(DEVICE, connect(session, clock))
        pipeline = open_pipeline(source, DEVICE, HELD, renderer)
        observers = Observers(trace, Taken(on_taken))
        loop = Loop(pipeline, Dispatcher(session, clock.now_ns), source, clock, observers, reconnect=True)
        on_ready()
        try:
            loop.run(stop)
        except LinkError as error:
            link_error = str(error)
    return ChainRun(tuple(trace), loop.counters, link.counters, link_error)


def state_of(change: CommandRecord) -> int:
    """State of the zones, as `state_index` numbers it; 0: no finger feels."""
    return 0 if change.placement is None else state_index(change.placement.zone_states(DEVICE))


def driven_hz(log: EmulatorLog) -> list[float]:
    """Frequencies that the firmware played, in order; one that was only interrupted counts once."""
    played_hz = (event.channels[0].frequency_hz for event in log.events if not is_silent(event))
    return [frequency_hz for frequency_hz, _ in groupby(played_hz)]


def is_silent(event: DriveEvent) -> bool:
    """Whether every target is zero."""
    return not any(channel.amplitude for channel in event.channels)
