"""Everything that a loop plays of one table, for one connected device: commands, basis of clicks, zones and limits.

It takes longer than a loop may wait, so it is made before the run, and in another process during one.
"""

from dataclasses import dataclass, replace

import numpy as np

from engine.device import Device
from engine.effects.effect_player import DEFAULT_CLICK_NS
from engine.effects.rules import Drives, Effects
from engine.render.board_fit import BoardFit, RendererError, choose_basis, fit_board, play_ns, scaled
from engine.render.limits import link_configuration
from engine.render.renderer import RenderedClicks, Renderer, Steady, SteadyDrives, ZoneDrives
from engine.table import Table
from firmware_link.host.link_values import Capabilities, LinkConfiguration
from firmware_link.protocol.basis import Basis

NS_PER_S = 1_000_000_000


@dataclass(frozen=True)
class Rendering:
    """One table, rendered for one connected device."""

    device: Device
    renderer: Renderer
    configuration: LinkConfiguration  # the limits of the device and the basis of clicks
    click_length_ns: int
    click_ahead_ns: int  # from the scan of a report to the peak of its click; 0: no clicks are played
    fit: BoardFit  # how the amplitudes of the table are played on the device

    @property
    def basis(self) -> Basis | None:
        """The basis that the device is to hold; None: the table has no clicks, or the device or its line carry none."""
        return self.configuration.basis


def render_table(
    table: Table,
    effects: Effects,
    capabilities: Capabilities,
    bit_rate_hz: int = 115_200,
    *,
    refuses: bool = False,
    has_kernels: bool = True,
    click_ns: int | None = None,
) -> Rendering:
    """Fit a table to the rules and a device; raises RendererError and LimitError where they do not fit together.

    refuses: silence is played where a level is not reached, in place of the strongest that there is.
    has_kernels: the kernels that solve steady drives may be loaded; without them drives are solved in NumPy.
    click_ns: how long a click, or the steady drive in its place, is wanted; None: as long as the table's clicks.
    """
    device, clicks = table.device, table.clicks
    fit = fit_board(device, capabilities)
    configuration = link_configuration(device, bit_rate_hz, fit.scales)
    lease_ms = min(configuration.lease_ms, capabilities.longest_lease_ms)
    basis = choose_basis(clicks.basis if effects.have_clicks else None, capabilities, bit_rate_hz, lease_ms)
    basis = scaled(basis, fit.scales)
    steady: Steady
    if effects.drives is Drives.ZONES:
        if not table.best_rows:
            raise RendererError(f"{table.path}: drives of zones: {table.no_row_text(())}")
        steady = ZoneDrives(device, capabilities, table.best_rows, refuses, fit.scales)
    else:
        steady = SteadyDrives(device, capabilities, table.modes, refuses, fit.scales, has_kernels=has_kernels)
    renderer = Renderer(capabilities, steady, RenderedClicks(clicks, basis, refuses), effects.levels_db)
    length_ns = _longest_ns(clicks.basis) if click_ns is None else click_ns
    ahead_ns = 0
    if basis.basis is not None and len(clicks):
        # The middle of all peaks: half of them are within 3 ms of it, in which a finger at 100 mm/s moves 0.3 mm.
        ahead_s = device.touch_axis.latency_s + float(np.median(clicks.peak_s))
        ahead_ns = round(NS_PER_S * ahead_s) + play_ns(clicks.weights.shape[1], bit_rate_hz)
    return Rendering(device, renderer, replace(configuration, basis=basis.basis), length_ns, ahead_ns, fit)


def _longest_ns(basis: Basis | None) -> int:
    if basis is None:
        return DEFAULT_CLICK_NS
    return max(NS_PER_S * (each.samples - 1) // basis.sample_rate_hz for each in basis.sets)
