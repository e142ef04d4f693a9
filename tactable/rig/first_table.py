"""The first table of a device, made in a moment: receptances alone, of which steady drives are solved at once.

A build needs compiled kernels, which take a minute of processor time on a machine that never ran one. The bar's modes
need none. Their sums give the receptances between places, as many modes as the moving bar of the page has, so that the
page plays one's own device while the kernels are compiled and the table is built. Such a table has no entries and no
sweeps, and goes with its run. Once kernels are compiled it has the best rows of a sweep that is not kept.

It has no clicks either until kernels are compiled. Then one click is solved, which brings the basis that a device must
hold, and a run that plays the table solves the clicks of the placements that are touched, as it does those of three
fingers (`tactable.run.click_process`). Their places and options are those of a table with coarse clicks.
"""

import json
from dataclasses import asdict
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from engine.device import Device
from engine.steady.receptances import Receptances
from engine.table import Table
from engine.table.best_rows import BestRows, write_best_rows
from engine.table.click_columns import write_clicks
from engine.table.clicks import Clicks
from engine.table.file import TableWriter
from engine.table.receptance_columns import write_receptances
from engine.touch.places import Places
from precompute.model.assembly import assemble
from precompute.model.frequencies import add_resonances
from precompute.model.modal import Basis, compute_basis, compute_modal_model
from precompute.model.transfers import transfers_at

IS_FIRST = "is_first"
"""Attribute of a table of receptances alone."""
MODES = 24
"""Modes of the page's moving bar; more of them change its levels by less than 0.05 dB."""
_PITCH_M = 5e-3
_FEWEST_PLACES = 5


def open_first_table(device: Device, path: Path, *, has_rows: bool = False) -> Table:
    """Make the first table of a device at `path`, and open it; `has_rows` as for `write_first_table`.

    Raises TableError where it cannot be written.
    """
    write_first_table(device, path, has_rows=has_rows)
    return Table.open(path, device=device, verify=False)


def solve_first_click(device: Device) -> Clicks:
    """The click of one finger in the middle; where its kernels are not compiled yet, they are."""
    from precompute.clicks import DEFAULT_OPTIONS, ClickSolver
    from precompute.clicks.columns import ClickTabulator

    places = Places.every(device.bar.length_m, DEFAULT_OPTIONS.coarse.pitch_m)
    options = DEFAULT_OPTIONS.coarse.at(places).quick
    click = ClickSolver(device, options).solve(places.placement((2 * (places.count // 2) + 1,)))
    return Clicks.of(places, [ClickTabulator(device, options).tabulate(click)])


def is_first(table: Table) -> bool:
    """Whether a table has receptances alone, and goes with its run."""
    return IS_FIRST in table.attributes


def write_first_table(device: Device, path: Path, clicks: Clicks | None = None, *, has_rows: bool = False) -> None:
    """Write the first table of a device, with what `solve_first_click` gave; what is at `path` is replaced.

    With `has_rows` it has the best rows of the sweep, which takes compiled kernels. Raises TableError where it cannot
    be written.
    """
    basis = compute_basis(assemble(device), MODES)
    receptances = modal_receptances(basis)
    with TableWriter(path, completes=True) as writer:
        writer.describe(
            {
                "title": f"first table of {device.name}",
                "Conventions": "CF-1.10",
                "device_name": device.name,
                "device_description": device.text,
                "device_fingerprint": device.fingerprint,
                "threshold": device.threshold.title,
                "code_fingerprint": "",  # it goes with the run
                "code_version": metadata.version("tactable"),
                "created": datetime.now(UTC).isoformat(timespec="seconds"),
                "clicks_are_coarse": 1,  # it has no entries either
                IS_FIRST: 1,
                "modes": MODES,
                **_click_attributes(clicks, receptances.pitch_m),
            }
        )
        write_receptances(writer, receptances, device)
        if has_rows and (rows := _best_rows(device)):
            write_best_rows(writer, rows, device)
        if clicks is not None:
            write_clicks(writer, clicks, device)


def _best_rows(device: Device) -> BestRows:
    from precompute.sweep.tabulate import find_best_rows  # it loads compiled kernels

    return find_best_rows(device)


def _click_attributes(clicks: Clicks | None, pitch_m: float) -> dict[str, Any]:
    """How the clicks are solved that a run asks for; without a click `pitch_m` is that of the places."""
    if clicks is None:
        return {"click_pitch_m": pitch_m, "click_tolerance_m": pitch_m / 2}
    from precompute.clicks import DEFAULT_OPTIONS  # whoever solved a click has imported it

    return {
        "click_pitch_m": clicks.places.pitch_m,
        "click_tolerance_m": clicks.tolerance_m,
        "click_options": json.dumps(asdict(DEFAULT_OPTIONS.coarse)),
    }


def modal_receptances(basis: Basis) -> Receptances:
    """Receptances of the untouched bar at even places, from sums of its modes."""
    plant = basis.plant
    device, count = plant.device, len(basis.square_omega)
    middles_m = [(zone.start_m + zone.stop_m) / 2 for zone in device.zones]
    loads = [[], [(at_m, device.finger) for at_m in middles_m], *([(at_m, device.finger)] for at_m in middles_m)]
    models = [compute_modal_model(basis, load) for load in loads]
    frequency_hz = add_resonances(device, device.sweep.frequency_hz, np.concatenate([each.pole for each in models]))
    places = max(int(np.ceil(device.bar.length_m / _PITCH_M - 1e-9)) + 1, _FEWEST_PLACES)
    place_m = np.linspace(0.0, device.bar.length_m, places)
    shape = basis.at(place_m)
    s = 2j * np.pi * frequency_hz[:, None, None]
    inverse = np.linalg.inv(np.diag(basis.square_omega) + s**2 * np.eye(count) + s * basis.damping)
    spread = shape @ inverse  # (frequency, place, mode)
    push, transfers = models[0].push, transfers_at(device.actuators, s[:, 0, 0])
    force = push[:, 0] + s * push[:, 1]
    if transfers is not None:
        force = force * transfers[:, None]
    row, column = np.triu_indices(places)
    return Receptances(
        frequency_hz=frequency_hz,
        threshold_m_per_s2=device.threshold.peak_m_per_s2(frequency_hz),
        place_m=place_m,
        drive=np.ascontiguousarray((spread @ force).transpose(1, 2, 0), dtype=np.complex64),
        point=np.ascontiguousarray((spread @ shape.T)[:, row, column].T, dtype=np.complex64),
    )
