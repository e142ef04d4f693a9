"""A table, a source of touches and a port to a run of the engine: what `tactable run` and the simulated rig share."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

from engine.click import choose_bank
from engine.digitizer import open_digitizer
from engine.effect_player import DEFAULT_CLICK_NS, EffectPlayer
from engine.effects import DEFAULT_EFFECTS, Effects
from engine.latency import LatencyRecorder
from engine.limits import link_configuration
from engine.loop import NS_PER_S, Clock, Loop, Reopening, StateChange, StopRequest, connect
from engine.realtime import Outcome, Step, real_time
from engine.renderer import Renderer, WhenNotAchieved
from engine.ring import RingWriter
from engine.sources import Source
from engine.table import Table
from engine.zones import ZoneTracker
from firmware_link.link import Link
from firmware_link.session import Port, Session


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


class Live:
    """The engine between a source and a port: greeted and encoded when it is made, then `run`.

    With `reopening` a run outlasts the loss of its port: the device is greeted and armed again once it is back.
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
    ) -> None:
        device, effects = table.device, options.effects
        self.digitizer = open_digitizer(source.descriptor, source.vendor_id, source.product_id)
        entries = {level_db: table.entries_at(level_db) for level_db in effects.levels_db}
        clicks = {level_db: table.clicks_at(level_db) for level_db in effects.levels_db if effects.have_clicks}
        self.wants_clicks = effects.have_clicks
        configuration = link_configuration(device, options.bit_rate_hz)
        self.latency = LatencyRecorder()
        self.capabilities = connect(Session(Link(configuration), port, clock.now_ns), clock)
        self.bank, waveforms = choose_bank(table.clicks if effects.have_clicks else (), self.capabilities)
        self.renderer = Renderer(entries, device, self.capabilities, options.when_not_achieved, clicks, waveforms)
        self.link = Link(replace(configuration, bank=self.bank))
        self.outcomes: tuple[Outcome, ...] = ()
        """What became of each real-time step, once it runs."""
        self._options, self._clock = options, clock
        session = self._session = Session(self.link, port, clock.now_ns)
        self.loop = Loop(
            source,
            self.digitizer,
            ZoneTracker(device, self.digitizer.surface),
            EffectPlayer(effects, len(device.zones), _click_length_ns(table)),
            self.renderer,
            session,
            clock,
            reconnect=options.reconnect,
            reopening=reopening,
            trace=trace,
            latency=self.latency,
            ring=ring,
        )

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


def _click_length_ns(table: Table) -> int:
    """The longest of the table's clicks: so long a click is an effect."""
    return max((round(NS_PER_S * click.length_s) for click in table.clicks), default=DEFAULT_CLICK_NS)
