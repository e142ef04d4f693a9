"""Contrast against level for one state of the fingers: the best drives, the table's, and the paper's objective."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from engine.device import Device
from engine.table import Entry, Table, TableError
from engine.touch import ZoneState, state_index
from precompute.entries.alternatives import paper_drive
from precompute.entries.prediction import States
from precompute.entries.solver import EntrySolver
from precompute.model.assembly import assemble
from tactable.figures.file import Picture
from tactable.figures.style import BLACK, BLUE, GREEN, GREY, VERMILLION, Array, finish_picture, state_text, zone_lists

Complex = NDArray[np.complex128]

STEP_DB = 0.5
"""Distance between the levels that are solved."""
_LEAST_SPAN_DB = 10.0
"""Where even full scale is hardly felt, the levels reach this far below it."""


@dataclass(frozen=True)
class Front:
    """Drives of one state, each array (drive,): level_db of the weakest felt finger, contrasts in dB, frequency_hz."""

    level_db: Array
    expected_db: Array
    standard_db: Array
    worst_db: Array
    frequency_hz: Array
    """Shape (drive, actuator)."""
    amplitude: Complex
    """Shape (drive, actuator): fractions of full scale."""


_CURVES = (
    ("expected_db", "expected: powers averaged\nover the sampled touches", BLUE, "-"),
    ("standard_db", "standard fingers", GREEN, "--"),
    ("worst_db", "worst of the touches", VERMILLION, ":"),
)
_MAXIMISED = {"contrast": "expected_db", "standard contrast": "standard_db"}
"""Fields by the name of the objective, where it is one of the curves."""


def plot_pareto(table: Table, states: States) -> Picture:
    """Picture of a state, which is solved at many levels. Raises TableError where nothing is felt or nothing quiet."""
    if ZoneState.QUIET not in states or ZoneState.FELT not in states:
        raise TableError("contrast is between fingers: name felt and quiet zones, such as --felt I --quiet IV")
    objective = str(table.attributes["objective"])
    front, paper = solve_front(table.device, states, objective), solve_paper_drive(table.device, states)
    entries = (table.entry_at(state_index(states), level_db) for level_db in table.levels_db)
    held = _front_of([entry for entry in entries if entry is not None])
    figure = Figure(figsize=(9, 4.6), layout="constrained")
    axes = figure.add_subplot()
    _draw(axes, front, held, paper, _MAXIMISED.get(objective))
    return finish_picture(
        figure,
        table.device,
        f"{table.device.name}: {state_text(table.device, states)}",
        f"expected contrast {front.expected_db[0]:z.1f} dB at {front.level_db[0]:g} dB, "
        f"{front.expected_db[-1]:z.1f} dB at full scale ({front.level_db[-1]:.1f} dB); "
        f"paper's objective {paper.expected_db[0]:z.1f} dB, up to {paper.level_db[0]:.1f} dB",
        _columns(table.device, front, paper),
        _summary(table, states, front, held, paper),
        subtitle=f"contrast against level; objective of the table: {objective}",
    )


def solve_front(device: Device, states: States, objective: str) -> Front:
    """The best drive at every level that can be reached, STEP_DB apart, and at full scale."""
    loudest_db = EntrySolver(assemble(replace(device, levels_db=()))).solve(states)[-1].level_db
    least_db = min(0.0, STEP_DB * np.floor((loudest_db - _LEAST_SPAN_DB) / STEP_DB))
    levels_db = tuple(np.arange(least_db, loudest_db, STEP_DB).tolist())
    return _front_of(EntrySolver(assemble(replace(device, levels_db=levels_db)), objective).solve(states))


def solve_paper_drive(device: Device, states: States) -> Front:
    """The drive of greatest localized factor on the untouched bar (paper eq. (11)), at full scale, fingers put on."""
    solver = EntrySolver(assemble(device))
    return _front_of([solver.evaluate(states, np.inf, paper_drive(solver, states), "paper's objective")])


def _front_of(entries: Sequence[Entry]) -> Front:
    def column(values: Iterable[float | None]) -> Array:
        return np.array(list(values), dtype=np.float64)

    amplitude = np.array([entry.amplitudes for entry in entries])
    return Front(
        level_db=column(entry.level_db for entry in entries),
        expected_db=column(entry.expected_contrast_db for entry in entries),
        standard_db=column(entry.contrast_db for entry in entries),
        worst_db=column(entry.worst_case.contrast_db for entry in entries),
        frequency_hz=np.array([entry.frequencies_hz for entry in entries]),
        amplitude=amplitude * np.exp(1j * np.array([entry.phases_rad for entry in entries])),
    )


def _draw(axes: Axes, front: Front, held: Front, paper: Front, maximised: str | None) -> None:
    for name, text, colour, style in _CURVES:
        label = f"{text} (maximised)" if name == maximised else text
        axes.plot(front.level_db, getattr(front, name), color=colour, ls=style, lw=1.8, label=label)
    for name, _, colour, _ in _CURVES:
        axes.plot(held.level_db, getattr(held, name), "o", ms=6, mec="white", color=colour)
        level_db, contrast_db = paper.level_db[0], getattr(paper, name)[0]
        axes.plot(level_db, contrast_db, "X", ms=9, mec="white", color=colour)
        axes.plot([min(level_db, front.level_db[0]), level_db], [contrast_db] * 2, color=colour, lw=0.8, alpha=0.6)
    if maximised is not None:
        label = "the table between its levels:\nthe next one, softer"
        axes.step(held.level_db, getattr(held, maximised), where="pre", color=GREY, lw=1.0, zorder=1, label=label)
    axes.plot([], [], "o", ms=6, mec="white", color=BLACK, label="in the table")
    label = "paper's objective (untouched bar),\nat full scale and softer"
    axes.plot([], [], "X-", ms=9, mec="white", lw=0.8, color=BLACK, label=label)
    axes.axhline(0.0, color=BLACK, lw=0.6)
    axes.set(xlabel="level of the weakest felt finger (dB above threshold)", ylabel="contrast, felt over quiet (dB)")
    axes.grid(alpha=0.25)
    axes.legend(fontsize="x-small", loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0)


def _columns(device: Device, front: Front, paper: Front) -> dict[str, Sequence[object] | NDArray[Any]]:
    """The front's drives, then the paper's."""

    def both(name: str) -> NDArray[Any]:
        return np.concatenate([getattr(front, name), getattr(paper, name)])

    frequency_hz, amplitude = both("frequency_hz"), both("amplitude")
    columns: dict[str, Sequence[object] | NDArray[Any]] = {
        "drive": ["best"] * len(front.level_db) + ["paper's objective"],
        "level (dB above threshold)": both("level_db"),
        "expected contrast (dB)": both("expected_db"),
        "standard contrast (dB)": both("standard_db"),
        "worst contrast (dB)": both("worst_db"),
    }
    for i, actuator in enumerate(device.actuators):
        columns[f"frequency of {actuator.name} (Hz)"] = frequency_hz[:, i]
        columns[f"amplitude of {actuator.name} (fraction of full scale)"] = abs(amplitude[:, i])
        columns[f"phase of {actuator.name} (rad)"] = np.angle(amplitude[:, i])
    return columns


def _summary(table: Table, states: States, front: Front, held: Front, paper: Front) -> dict[str, object]:
    return {
        **zone_lists(table.device, states),
        "objective": table.attributes["objective"],
        "loudest_db": float(front.level_db[-1]),
        "front": _points(front),
        "held": _points(held),
        "paper": _points(paper)[0],
    }


def _points(front: Front) -> list[dict[str, float]]:
    names = ("level_db", "expected_db", "standard_db", "worst_db")
    keys = ("level_db", "expected_contrast_db", "contrast_db", "worst_contrast_db")
    rows = zip(*(getattr(front, name).tolist() for name in names), strict=True)
    return [dict(zip(keys, row, strict=True)) for row in rows]
