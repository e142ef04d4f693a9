"""Every state of one felt and one quiet finger: the paper's objective against ours, in frequency and in time."""

import itertools
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table as Grid
from threadpoolctl import threadpool_limits

from engine.device import Device
from engine.table import Entry, Table
from engine.touch import ZoneState
from precompute.entries.alternatives import paper_drive
from precompute.entries.prediction import touched_zones
from precompute.entries.solver import EntrySolver
from precompute.model.assembly import assemble
from precompute.model.modal import compute_basis
from precompute.model.transient import TransientPlant

Array = NDArray[np.float64]

_SAMPLES_PER_CYCLE = 100
_SETTLING_S, _WINDOW_S = 4.0, 0.2


def run_contrast_bench(table: Table, level_db: float) -> dict[str, Any]:
    """Contrast of both drives in the loaded plant, and what the time-domain plant measures of them. SIMULATED."""
    with threadpool_limits(1, "blas"):
        solver = EntrySolver(assemble(table.device))
        bar = TimeDomain(table.device)
        rows = [
            _compare(table, solver, bar, pair, level_db)
            for pair in itertools.permutations(range(len(table.device.zones)), 2)
        ]
    return {"simulated": True, "device": table.device.name, "level_db": level_db, "states": rows}


class TimeDomain:
    """The time-domain plant of a device with standard fingers on it."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._basis = compute_basis(assemble(device))

    def levels_under(self, entry: Entry) -> Array:
        """Peak acceleration in m/s^2 under each finger of the entry's state, after the drive was held until steady."""
        middles_m = [(zone.start_m + zone.stop_m) / 2 for zone in self._device.zones]
        at_m = np.array([middles_m[zone] for zone in touched_zones(entry.states)])
        rate_hz = _SAMPLES_PER_CYCLE * max(entry.frequencies_hz)
        plant = TransientPlant(self._basis, at_m, rate_hz)
        plant.touch([(position_m, self._device.finger) for position_m in at_m.tolist()])
        time_s = np.arange(round((_SETTLING_S + _WINDOW_S) * rate_hz)) / rate_hz
        turn = 2 * np.pi * time_s[:, None] * np.array(entry.frequencies_hz) + np.array(entry.phases_rad)
        acceleration, _ = plant.run(np.array(entry.amplitudes) * np.cos(turn))
        peak: Array = abs(acceleration[time_s >= _SETTLING_S]).max(axis=0)
        return peak


def _compare(
    table: Table, solver: EntrySolver, bar: TimeDomain, pair: tuple[int, int], level_db: float
) -> dict[str, Any]:
    felt, quiet = (table.device.zones[zone].name for zone in pair)
    states = table.states_of([felt], [quiet])
    ours = table.entry_for([felt], [quiet], level_db)
    paper = solver.judge(states, level_db, paper_drive(solver, states), "paper")
    return {"felt": felt, "quiet": quiet, "paper": _figures(bar, paper), "ours": _figures(bar, ours)}


def _figures(bar: TimeDomain, entry: Entry) -> dict[str, Any]:
    level = bar.levels_under(entry)
    kinds = [state for state in entry.states if state is not ZoneState.FREE]
    measured_db = 20 * np.log10(level[kinds.index(ZoneState.FELT)] / level[kinds.index(ZoneState.QUIET)])
    return {
        "frequencies_hz": list(entry.frequencies_hz),
        "level_db": entry.level_db,
        "contrast_db": entry.contrast_db,
        "time_domain_contrast_db": float(measured_db),
        "expected_contrast_db": entry.expected_contrast_db,
        "worst_contrast_db": entry.worst_case.contrast_db,
    }


def print_contrast_bench(out: Console, result: dict[str, Any]) -> None:
    """The states as a table: contrast in dB in the loaded plant / in the time-domain plant, expected, level reached."""
    grid = Grid(
        "felt",
        "quiet",
        "paper: dB",
        "in time",
        "expected",
        "level",
        "ours: dB",
        "in time",
        "expected",
        "level",
        title=f"{result['device']}, {result['level_db']:g} dB wanted, fingers on the bar, SIMULATED",
    )
    for row in result["states"]:
        cells = [row["felt"], row["quiet"]]
        for who in ("paper", "ours"):
            keys = ("contrast_db", "time_domain_contrast_db", "expected_contrast_db", "level_db")
            cells += [f"{row[who][key]:.1f}" for key in keys]
        grid.add_row(*cells)
    out.print(grid)
