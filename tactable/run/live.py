"""A table, a source of touches and a port to a run of the engine: what `tactable run` and the simulated rig share."""

import ctypes
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from engine.effects import DEFAULT_EFFECTS, EffectPlayer, Effects
from engine.loop.fast.step import FastPath, FastPathError, PacketSource, compile_fast_path
from engine.loop.latency import LatencyRecorder
from engine.loop.loop import Clock, Loop, Reopening, StateChange, StopRequest, Updates, connect
from engine.loop.realtime import Outcome, Step, real_time
from engine.loop.ring import RingWriter
from engine.render.limits import link_configuration
from engine.render.prepared import render_table
from engine.render.renderer import WhenNotAchieved
from engine.table import Table
from engine.touch import FingerTracker, open_digitizer
from engine.touch.scan_time import ScanTimes
from engine.touch.sources import Source
from firmware_link.host.link import Link
from firmware_link.host.link_values import Capabilities
from firmware_link.host.session import Port, Session
from tactable.shipped import cache_folder


@dataclass(frozen=True)
class LiveOptions:
    """How a run goes, beside what it runs."""

    effects: Effects = DEFAULT_EFFECTS
    when_not_achieved: WhenNotAchieved = WhenNotAchieved.WARN
    reconnect: bool = False
    """A device that stopped itself is greeted and armed again; otherwise that ends the run."""
    bit_rate_hz: int = 115_200
    steps: tuple[Step, ...] = (Step.COLLECTOR,)
    """What to ask of the machine while it runs: the loop makes no cycles, and to collect all that lives takes 0.1 s."""
    processor: int | None = None
    """For the affinity; None: the last."""
    fast: ctypes.CDLL | None = None
    """The compiled step from a report to its command, where the source has packets; None: the loop does all."""


def fast_library() -> ctypes.CDLL | None:
    """The compiled step, made when it is first asked for; None where it cannot be made here."""
    try:
        return compile_fast_path(cache_folder())
    except FastPathError:
        return None


class Live:
    """The engine between a source and a port: greeted and encoded when it is made, then `run`.

    With `reopening` a run outlasts the loss of its port: the device is greeted and armed again once it is back. With
    `watch`, which is told the device's capabilities, it changes over to new tables.
    Its parts hold the counters, during the run and after it. Raises what they raise: DigitizerError, DescriptorError,
    LinkError, LimitError, RendererError.
    """

    def __init__(
        self,
        table: Table,
        source: Source,
        port: Port,
        clock: Clock,
        options: LiveOptions,
        trace: list[StateChange] | None = None,
        reopening: Reopening | None = None,
        ring: RingWriter | None = None,
        watch: Callable[[Capabilities], Updates] | None = None,
        fast_path: Callable[..., FastPath] = FastPath,
    ) -> None:
        effects, self._make_fast_path = options.effects, fast_path
        self.digitizer = open_digitizer(source.descriptor, source.vendor_id, source.product_id)
        self.wants_clicks = effects.have_clicks
        self.latency, self.scan_times = LatencyRecorder(), ScanTimes()
        greeting = Link(link_configuration(table.device, options.bit_rate_hz))
        self.capabilities = connect(Session(greeting, port, clock.now_ns), clock)
        rendering = render_table(table, effects, self.capabilities, options.when_not_achieved, options.bit_rate_hz)
        self.bank, self.renderer = rendering.bank, rendering.renderer
        self.link = Link(rendering.configuration)
        self.no_fast_path = ""
        """Why there is none, where one was asked for."""
        self.outcomes: tuple[Outcome, ...] = ()
        """What became of each real-time step, once it runs."""
        self._options, self._clock = options, clock
        session = self._session = Session(self.link, port, clock.now_ns)
        player = EffectPlayer(effects, len(table.device.zones), rendering.click_length_ns)
        self.loop = Loop(
            source,
            self.digitizer,
            FingerTracker(table.device, self.digitizer.surface),
            player,
            self.renderer,
            session,
            clock,
            reconnect=options.reconnect,
            reopening=reopening,
            trace=trace,
            latency=self.latency,
            scan_times=self.scan_times,
            ring=ring,
            updates=None if watch is None else watch(self.capabilities),
            bank_data=rendering.bank_data,
            fast=None if options.fast is None else self._fast_path(options.fast, source, player),
            fast_table=rendering.fast_table,
        )

    def _fast_path(self, library: ctypes.CDLL, source: Source, player: EffectPlayer) -> FastPath | None:
        if not isinstance(source, PacketSource):
            return None
        try:
            rules = self._options.effects
            return self._make_fast_path(library, source, self.digitizer, player, rules, self._clock.now_ns)
        except FastPathError as error:
            self.no_fast_path = str(error)
            return None

    @property
    def clicks(self) -> int:
        """How many clicks the device holds."""
        return 0 if self.bank is None else len(self.bank.waveforms)

    @property
    def frames_sent(self) -> int:
        """SET and PLAY frames, renewals of the lease included."""
        return self.link.counters.sent + self.link.counters.renewed

    def run(self, stop: StopRequest | None = None) -> None:
        """Until the source has ended or `stop` is set; raises LinkError when the port or the device fails."""
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
