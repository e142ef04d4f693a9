"""A table, a source of touches and a port to a run of the engine: what `tactable run` and the simulated rig share."""

import ctypes
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from base.files import work_folder
from engine.device import Device
from engine.effects.rules import DEFAULT_EFFECTS, Effects
from engine.loop.beside import ClickSolving, ControlSlot, Updates
from engine.loop.dispatcher import Dispatcher, Reopening
from engine.loop.fast.fast_layout import with_fast_table
from engine.loop.fast.fast_path import FastPath, PacketSource
from engine.loop.fast.library import FastPathError, compile_fast_path
from engine.loop.fast.moment import FastLink, FastSession
from engine.loop.loop import Clock, Loop, Measuring, StopRequest, connect
from engine.loop.observer import Observer, Observers, Timing
from engine.loop.pipeline import LATEST_NS, open_pipeline
from engine.loop.realtime import Outcome, Step, real_time
from engine.loop.ring import RingWriter
from engine.render.limits import link_configuration
from engine.render.prepared import render_table
from engine.table import Table
from engine.touch.sources import Source
from firmware_link import BIT_RATE_HZ
from firmware_link.host.link import Link
from firmware_link.host.link_values import Capabilities
from firmware_link.host.session import Port, Session
from tactable.shipped import cache_folder


@dataclass(frozen=True)
class LiveOptions:
    """Options of a run: rules, what the loop does about losses, real-time settings, the compiled step."""

    effects: Effects = DEFAULT_EFFECTS
    refuses: bool = False  # silence where a level is not reached, in place of the strongest drive or click
    reconnect: bool = False  # a device that stopped itself is greeted and armed again; otherwise that ends the run
    bit_rate_hz: int = BIT_RATE_HZ
    steps: tuple[Step, ...] = (Step.COLLECTOR,)  # real-time settings; the loop makes no cycles to collect
    processor: int | None = None  # the processor of the affinity; None: the last
    fast: ctypes.CDLL | None = None  # the compiled step, for a source of packets; None: the loop answers
    has_kernels: bool = True  # compiled kernels may solve steady drives; False: NumPy does
    click_ns: int | None = None  # how long a click, or a drive in its place, is wanted; None: as the table's
    patience_ns: int = LATEST_NS  # for how long after its touch a click is awaited that is solved beside the loop


def fast_library(tell: Callable[[str], None] = lambda _: None) -> ctypes.CDLL | None:
    """The compiled step, compiled at the first call; None where it cannot be compiled here, which `tell` is told."""
    try:
        return compile_fast_path(cache_folder())
    except FastPathError as error:
        tell(f"commands take the loop's own way: {error}")
        return None


class Live:
    """The engine between a source and a port. Making one greets the device and encodes the table; `run` starts it.

    With `reopening` a run outlasts the loss of its port: the device is greeted and armed again once it is back. With
    `watch`, called with the device's capabilities, it changes to new tables; with `solving` it gets the clicks that the
    table does not hold, with `control` the steps of programs, and `measuring` the samples of the board's accelerometer.
    `observer` gets the records of the run
    beside its own `timing`. The parts hold the counters, during the run and after it. Raises what they raise:
    DigitizerError, DescriptorError, LinkError, LimitError, RendererError.
    """

    def __init__(
        self,
        table: Table,
        source: Source,
        port: Port,
        clock: Clock,
        options: LiveOptions,
        observer: Observer | None = None,
        reopening: Reopening | None = None,
        watch: Callable[[Capabilities], Updates] | None = None,
        solving: ClickSolving | None = None,
        fast_path: Callable[..., FastPath] = FastPath,
        control: ControlSlot | None = None,
        measuring: Measuring | None = None,
    ) -> None:
        effects = options.effects
        self.wants_clicks = effects.have_clicks
        self.timing = Timing()
        greeting = Link(link_configuration(table.device, options.bit_rate_hz))
        self.capabilities = connect(Session(greeting, port, clock.now_ns), clock)
        rendering = render_table(
            table,
            effects,
            self.capabilities,
            options.bit_rate_hz,
            refuses=options.refuses,
            has_kernels=options.has_kernels,
            click_ns=options.click_ns,
        )
        self.renderer = rendering.renderer
        self.fit = rendering.fit  # how the first table's amplitudes are played on the board
        self.renderer.steady.prepare()
        self.link = FastLink(rendering.configuration)
        self.no_fast_path = ""  # why a fast path that was asked for cannot be had; "" otherwise
        self.outcomes: tuple[Outcome, ...] = ()  # the outcome of each real-time step, once it runs
        self._options, self._clock = options, clock
        self._session = FastSession(self.link, port, clock.now_ns)
        self.fast_counters = self._session.fast_counters
        rules = effects, self.renderer, clock.now_ns, rendering.click_length_ns
        pipeline = open_pipeline(source, table.device, *rules, source.report_id)
        self._pipeline = pipeline
        pipeline.player.ahead_ns = rendering.click_ahead_ns
        pipeline.answerer.patience_ns = options.patience_ns
        self.digitizer = pipeline.digitizer
        dispatcher = Dispatcher(self._session, clock.now_ns)
        observer = Observers(self.timing, observer)
        edges: tuple[Source, Clock, Observer] = (source, clock, observer)
        if options.fast is not None and isinstance(source, PacketSource):
            try:
                others = (clock, effects, with_fast_table(rendering, self.capabilities), observer)
                fast = fast_path(options.fast, source, pipeline, dispatcher, *others)
                edges = (fast.source, fast, fast)
            except FastPathError as error:
                self.no_fast_path = str(error)
        self.loop = Loop(
            pipeline,
            dispatcher,
            *edges,
            reconnect=options.reconnect,
            reopening=reopening,
            updates=None if watch is None else watch(self.capabilities),
            solving=solving if self.clicks else None,
            control=control,
            measuring=measuring,
        )

    @property
    def device(self) -> Device:
        """The device of the table that plays now."""
        return self._pipeline.device

    @property
    def clicks(self) -> int:
        """Number of the table's clicks that the device can play."""
        return self.renderer.clicks.number

    @property
    def frames_sent(self) -> int:
        """SET and PLAY frames, renewals of the lease included."""
        return self.link.counters.sent + self.link.counters.renewed

    def run(self, stop: StopRequest | None = None) -> None:
        """Run until the source has ended or `stop` is set. Raises LinkError when the port or the device fails."""
        with self.armed():
            self.loop.run(stop)

    @contextmanager
    def armed(self) -> Iterator[None]:
        """The real-time steps are in force and the device is armed: `loop` must run within 250 ms.

        Only now, since to encode the drives of eight zones at three levels takes longer, as steps may.
        """
        with real_time(self._options.steps, processor=self._options.processor) as self.outcomes:
            connect(self._session, self._clock)
            yield


@contextmanager
def ring_for(path: Path | None, *, is_needed: bool) -> Iterator[RingWriter | None]:
    """A ring where one is wanted or needed, removed at the end; else None. Raises RingError."""
    if path is not None:
        with RingWriter(path) as ring:
            yield ring
    elif is_needed:
        with work_folder("ring", in_memory=True) as folder, RingWriter(folder / "ring") as ring:
            yield ring
    else:
        yield None
