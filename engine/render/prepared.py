"""A table to all that a loop plays of it: commands, bank, zones, limits; made before it is needed."""

from dataclasses import dataclass, replace

from engine.device import Device
from engine.effects import Effects
from engine.effects.player import DEFAULT_CLICK_NS
from engine.render.limits import link_configuration
from engine.render.renderer import Renderer, WhenNotAchieved
from engine.table import Table
from engine.table.click import choose_bank
from firmware_link.host.link_values import Capabilities, LinkConfiguration
from firmware_link.protocol.bank import Bank, encode_bank

NS_PER_S = 1_000_000_000


@dataclass(frozen=True)
class Rendering:
    """One table for one connected device."""

    device: Device
    renderer: Renderer
    configuration: LinkConfiguration
    """Limits of the device, the bank of clicks."""
    bank_data: bytes
    """The bank as the device takes it; empty without one."""
    click_length_ns: int

    @property
    def bank(self) -> Bank | None:
        """Clicks that the device holds."""
        return self.configuration.bank


def render_table(
    table: Table,
    effects: Effects,
    capabilities: Capabilities,
    when_not_achieved: WhenNotAchieved = WhenNotAchieved.WARN,
    bit_rate_hz: int = 115_200,
) -> Rendering:
    """Everything encoded. Raises RendererError and LimitError for what does not fit the device."""
    device, levels_db = table.device, effects.levels_db
    entries = {level_db: table.entries_at(level_db) for level_db in levels_db}
    clicks = {level_db: table.clicks_at(level_db) for level_db in levels_db if effects.have_clicks}
    bank, waveforms = choose_bank(table.clicks if effects.have_clicks else (), capabilities)
    renderer = Renderer(entries, device, capabilities, when_not_achieved, clicks, waveforms)
    configuration = replace(link_configuration(device, bit_rate_hz), bank=bank)
    return Rendering(
        device,
        renderer,
        configuration,
        b"" if bank is None else encode_bank(bank, capabilities.number_of_actuators),
        max((round(NS_PER_S * click.length_s) for click in table.clicks), default=DEFAULT_CLICK_NS),
    )
