"""Promises for the positions that fingers really have: what standard fingers there get of a drive or a click.

A steady drive is solved for the positions from receptances between places; its promise is computed apart from that, by
finite elements at the drive's own frequency. A click is the table's for the nearest places; what it gives at the
positions follows from its waveform, in the nominal plant. Where no kernel is compiled, the promise of a drive
is what a sum of modes makes of it.
"""

import cmath
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from engine.steady import SteadyDrive
from engine.table import ClickEntry, Table
from engine.table.click import played_at
from engine.touch import Placement
from firmware_link.protocol.messages import ChannelDrive
from precompute.model.assembly import assemble
from tactable.rig.modal_bar import ModalBar
from tactable.rig.solved_click import SolvedClick

if TYPE_CHECKING:
    from engine.steady.solver import SteadySolver
    from tactable.explain.click_source import ClickSource

Array = NDArray[np.float64]
_SILENT = 1e-15


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

    @cached_property
    def _bar(self) -> ModalBar:
        return ModalBar(self._table.device)

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

    def of_channels(self, placement: Placement, channels: Sequence[ChannelDrive]) -> Promise:
        """What a steady drive gives, as a sum of modes: no kernel is loaded. Shape (actuator,): `channels`."""
        acceleration, weighted = np.zeros((2, len(placement.position_m)))
        for hz in {channel.frequency_hz for channel in channels if channel.amplitude}:
            base = np.array([_phasor(channel) * (channel.frequency_hz == hz) for channel in channels])
            reached = abs(self._bar.acceleration(hz, placement.position_m) @ base)
            acceleration = acceleration + reached
            weighted = np.hypot(weighted, reached / self._table.device.threshold.peak_m_per_s2(np.array([hz])))
        return Promise(placement, acceleration, 20 * np.log10(np.maximum(weighted, _SILENT)))

    def of_tabulated_click(self, placement: Placement, level_db: float) -> tuple[ClickEntry, Promise] | None:
        """The table's click of the nearest places, and its promise; None where the table has none."""
        click = self._table.click_at(placement, level_db)
        return None if click is None else (click, self._promise_of(click, placement))

    def of_click(self, placement: Placement, level_db: float) -> tuple[ClickEntry, Promise]:
        """The same, solved for the places where the table has none; that takes up to a second."""
        click = played_at(self._source.click_at_places(placement), level_db)
        return click, self._promise_of(click, placement)

    def of_solved_click(self, placement: Placement, solved: SolvedClick) -> tuple[ClickEntry, Promise]:
        """A click of the table's basis that was solved beside the run, as it is played, and its promise.

        Of the entry only the waveform is known; its other figures are those of the table's first click.
        """
        click = replace(
            self._table.clicks[0],
            placement=placement,
            basis_set=solved.basis_set,
            weights=solved.weights,
            fraction_bits=solved.fraction_bits,
            amplitude=solved.amplitude,
        )
        return click, self._promise_of(click, placement)

    def _promise_of(self, click: ClickEntry, placement: Placement) -> Promise:
        fingers = self._source.fingers_of(click, placement)
        return Promise(
            placement,
            np.array([finger.acceleration_at_finger_m_per_s2 for finger in fingers]),
            np.array([finger.level_db for finger in fingers]),
        )


def _phasor(channel: ChannelDrive) -> complex:
    """The base displacement of a channel as a complex amplitude, a fraction of full scale."""
    return cmath.rect(channel.amplitude, channel.phase_rad)
