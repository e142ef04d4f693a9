"""The first table of a device, made in a moment: modes alone, of which steady drives are solved at once.

A build needs compiled kernels, which take a minute of processor time on a machine that never ran one. The bar's modes
need none. As many are taken as the page's moving bar has, so that the page plays one's own device while kernels are
compiled and the table is built. Such a table has no sweeps, and goes with its run. Once kernels are compiled it has
the best rows of a sweep that is not kept.

It has no clicks either until kernels are compiled. Then one click is solved, which brings the basis that a device must
hold, and a run that plays the table solves the clicks of the placements that are touched, as it does those of three
fingers (`tactable.run.click_process`). Their places and options are those of a table with clicks at few places.
"""

import json
from dataclasses import asdict
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

from engine.device import Device
from engine.table import Table
from engine.table.best_rows import write_best_rows
from engine.table.clicks import Clicks
from engine.table.columns import write_clicks, write_modes
from engine.table.netcdf_file import TableWriter
from precompute.model.assembly import assemble
from precompute.model.modal import compute_basis
from precompute.sampling.steady_modes import steady_modes

if TYPE_CHECKING:
    from precompute.clicks import ClickOptions

IS_FIRST = "is_first"  # attribute of a table of modes alone
MODES, MOST_MODES = 24, 60
"""Modes of the page's moving bar, up to 9 kHz: more of them change its levels by less than 0.05 dB. Those of a plate:
3 kHz on a tablet, and more of them change the levels under fingers by less than 0.01 dB."""


def modes_of(device: Device) -> int:
    """Number of modes of the page's moving surface."""
    return MOST_MODES if device.surface.corner_m.imag else MODES


def early_options() -> "ClickOptions":
    """Clicks of tables that are there before the fine ones: few places, so that hundreds of clicks are all."""
    from precompute.clicks import ClickOptions  # it loads kernels

    return ClickOptions(pitch_m=16e-3)


def open_first_table(device: Device, path: Path, *, has_rows: bool = False, has_click: bool = False) -> Table:
    """Make the first table of a device at `path`, and open it; `has_rows` as for `write_first_table`.

    With `has_click` it has its first click, which takes compiled kernels. Raises TableError where it cannot be written.
    """
    write_first_table(device, path, solve_first_click(device) if has_click else None, has_rows=has_rows)
    return Table.open(path, device=device, verify=False)


def solve_first_click(device: Device) -> Clicks:
    """The click of one finger in the middle; where its kernels are not compiled yet, they are."""
    from precompute.clicks import ClickSolver

    places = early_options().places(device.surface.corner_m)
    middle = places.placement((2 * (places.count // 2) + 1,))
    return Clicks.of(places, [ClickSolver(device, early_options().at(places, device.spread)).solve(middle)])


def is_first(table: Table) -> bool:
    """Whether a table has modes alone, and goes with its run."""
    return IS_FIRST in table.attributes


def write_first_table(device: Device, path: Path, clicks: Clicks | None = None, *, has_rows: bool = False) -> None:
    """Write the first table of a device, with what `solve_first_click` gave; what is at `path` is replaced.

    With `has_rows` it has the best rows of the sweep, which takes compiled kernels. Raises TableError where it cannot
    be written.
    """
    basis = compute_basis(assemble(device), modes_of(device))
    modes = steady_modes(basis)
    with TableWriter(path, completes=True) as writer:
        writer.describe(
            {
                "title": f"first table of {device.name}",
                "Conventions": "CF-1.10",
                "device_name": device.name,
                "device_description": device.text,
                "device_fingerprint": device.fingerprint,
                "threshold": device.threshold.title,
                "spread": device.spread_text,
                "code_fingerprint": "",  # it goes with the run
                "code_version": metadata.version("tactable"),
                "created": datetime.now(UTC).isoformat(timespec="seconds"),
                IS_FIRST: 1,
                "modes": modes_of(device),
                **_click_attributes(clicks, modes.places.pitch_m),
            }
        )
        write_modes(writer, modes, device)
        if has_rows:
            from precompute.sweep.tabulate import find_best_rows  # it loads compiled kernels

            if rows := find_best_rows(device):
                write_best_rows(writer, rows, device)
        if clicks is not None:
            write_clicks(writer, clicks, device)


def _click_attributes(clicks: Clicks | None, pitch_m: float) -> dict[str, Any]:
    """How the clicks are solved that a run asks for; without a click `pitch_m` is that of the places."""
    if clicks is None:
        return {"click_pitch_m": pitch_m, "click_tolerance_m": pitch_m / 2}
    return {
        "click_pitch_m": clicks.places.pitch_m,
        "click_tolerance_m": clicks.tolerance_m,
        "click_options": json.dumps(asdict(early_options())),
    }
