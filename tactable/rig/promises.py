"""Promises for the positions that fingers really have: what standard fingers there get of a drive or a click.

A steady drive is solved for the positions from receptances between places; its promise is computed apart from that, by
finite elements at the drive's own frequency. A click is the table's for the nearest places; what it gives at the
positions follows from its waveform, in the nominal plant. Only promises of steady drives take compiled kernels.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from engine.steady import SteadyDrive
from engine.table import ClickEntry, Table
from engine.table.click import played_at
from engine.touch import Placement
from precompute.model.assembly import assemble

if TYPE_CHECKING:
    from engine.steady.solver import SteadySolver
    from tactable.explain.click_source import ClickSource

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Promise:
    """What standard fingers of a placement get: acceleration_m_per_s2 and level_db, peaks of shape (finger,)."""

    placement: Placement
    acceleration_m_per_s2: Array
    level_db: Array


class Promises:
    """Promises of one table; `prepare` loads what the first ones take."""

    def __init__(self, table: Table) -> None:
        self._table = table
        self._plant = assemble(table.device)

    @cached_property
    def _source(self) -> "ClickSource":
        from tactable.explain.click_source import ClickSource  # a table without clicks does not need Numba

        return ClickSource(self._table)

    @cached_property
    def _solver(self) -> "SteadySolver":
        from engine.steady.solver import SteadySolver

        return SteadySolver(self._table.device, self._table.receptances)

    def prepare(self, *, steady: bool = True) -> None:
        """Load what promises take, up to a second; those of `steady` drives compile their kernels where need be."""
        if steady:
            self._solver.prepare()
        for click in self._table.clicks[:1]:
            self._source.fingers_of(click, click.placement)

    def of_drive(
        self, placement: Placement, level_db: float, held_hz: float | None = None
    ) -> tuple[SteadyDrive, Promise]:
        """The steady drive of a placement, as a run solves it, and its promise.

        held_hz: frequency of the drive that is played; where the fingers moved, it may be that of an earlier one.
        """
        from precompute.model.response import solve_response

        drive = self._solver.solve(placement.position_m, placement.is_felt, level_db, held_hz)
        hz, device = np.array([drive.frequency_hz]), self._table.device
        loaded = self._plant.with_fingers(placement.position_m, device.finger)
        unit = solve_response(loaded, hz).acceleration(np.array(placement.position_m))[0]
        acceleration_m_per_s2 = abs(drive.complex_amplitudes @ unit)
        felt_db = 20 * np.log10(acceleration_m_per_s2 / device.threshold.peak_m_per_s2(hz))
        return drive, Promise(placement, acceleration_m_per_s2, felt_db)

    def of_tabulated_click(self, placement: Placement, level_db: float) -> tuple[ClickEntry, Promise] | None:
        """The table's click of the nearest places, and its promise; None where the table has none."""
        click = self._table.click_at(placement, level_db)
        return None if click is None else (click, self._promise_of(click, placement))

    def of_click(self, placement: Placement, level_db: float) -> tuple[ClickEntry, Promise]:
        """The same, solved for the places where the table has none; that takes up to a second."""
        click = played_at(self._source.click_at_places(placement), level_db)
        return click, self._promise_of(click, placement)

    def _promise_of(self, click: ClickEntry, placement: Placement) -> Promise:
        fingers = self._source.fingers_of(click, placement)
        return Promise(
            placement,
            np.array([finger.acceleration_at_finger_m_per_s2 for finger in fingers]),
            np.array([finger.level_db for finger in fingers]),
        )
