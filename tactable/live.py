"""A table, a source of touches and a port to a run of the engine: what `tactable run` and the simulated rig share."""

import gc
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
from engine.renderer import Renderer, WhenNotAchieved
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


class Live:
    """The engine between a source and a port: greeted, encoded and armed when it is made, then `run`.

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
        gc.collect()
        # An armed device waits 250 ms for the loop; the drives of eight zones at three levels take longer to encode.
        self.link = Link(replace(configuration, bank=self.bank))
        session = Session(self.link, port, clock.now_ns)
        connect(session, clock)
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
        with _without_collector():
            self.loop.run(stop)


def _click_length_ns(table: Table) -> int:
    """The longest of the table's clicks: so long a click is an effect."""
    return max((round(NS_PER_S * click.length_s) for click in table.clicks), default=DEFAULT_CLICK_NS)


@contextmanager
def _without_collector() -> Iterator[None]:
    """The loop makes no cycles; a collection of all that lives takes 0.1 s."""
    gc.freeze()
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        gc.unfreeze()
        if collects:
            gc.enable()
