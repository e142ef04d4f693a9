"""Promises for the positions that fingers really have: what standard fingers there get of a drive or a click.

A steady drive is solved for the positions from modes, or looked up for zones; its promise is
computed apart from that, by finite elements at the drive's own frequencies. A click is the table's for the nearest
places; what it gives at the positions follows from its waveform, in the nominal plant. Where no kernel is compiled, the
promise of a drive is what a sum of modes makes of it.

The promises of a table are made over bars that are not quite its own. `OtherBar` is one of them: drawn from the spread
of its device, touched by other fingers, beside where they seem. A demo that plays it shows what is left of the promises
where the model is wrong. SIMULATED.
"""

import cmath
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray

from base.arrays import Array, Complex
from base.points import clip_points
from engine.device import Device, Finger
from engine.steady import SteadyDrive
from engine.steady.steady_drive import standard_levels
from engine.table import ClickEntry, Table
from engine.table.best_rows import BestRow
from engine.table.clicks import played_at
from engine.touch import Placement
from firmware_link.protocol.basis import Basis, weighted_sum
from firmware_link.protocol.drive_words import ChannelDrive
from firmware_link.protocol.messages import FULL_SCALE_WORD, Play, decode_body, encode_play_body
from precompute.model.assembly import assemble
from precompute.sampling.plants import finger_factors, sample_scenarios
from tactable.explain.words import zone_names

_EQUAL = 1e-9  # a smaller difference is rounding
_BESIDE_M = 2e-3  # a table's places are 3 mm apart: its clicks are made for more than a digitizer's millimetre


def reach_beside_m(device: Device) -> float:
    """How far a finger may be from where it seems to be, evenly distributed to both sides along every axis."""
    return max(_BESIDE_M, device.spread.reach_m)


class OtherBar:
    """One bar of those that `seed` numbers, and the fingers on it, of which each contact has its own."""

    def __init__(self, device: Device, seed: int) -> None:
        self.nominal, self._seed = device, seed  # nominal: the device of the table
        self._touching = dict[int, tuple[complex, Finger]]()

    @cached_property
    def device(self) -> Device:
        """The device as it is."""
        return sample_scenarios(self.nominal, 1, self._seed).device_of(1)

    def finger_of(self, contact: int, at_m: complex) -> tuple[complex, Finger]:
        """Where the finger of a contact really is that seems to be at `at_m`, and what it is like."""
        if contact not in self._touching:
            random = np.random.default_rng([self._seed, contact])
            along, across = reach_beside_m(self.nominal) * random.uniform(-1, 1, 2)
            is_plate = isinstance(self.nominal.surface.corner_m, complex)
            mass, damping, stiffness = finger_factors(self.nominal, random.uniform(-1, 1, 3)).tolist()
            was = self.nominal.finger
            finger = Finger(
                was.mass_kg * mass, was.damping_n_s_per_m * damping, was.stiffness_n_per_m * stiffness, was.spread
            )
            beside_m = complex(along, across) if is_plate else along
            self._touching[contact] = beside_m, finger
        beside_m, finger = self._touching[contact]
        true_m: complex = clip_points(np.array(at_m + beside_m), self.nominal.surface.corner_m).item()
        return true_m, finger

    def __str__(self) -> str:
        """How it differs, in words."""
        was, now = self.nominal, self.device
        pairs = list(zip(now.actuators, was.actuators, strict=True))
        mounts = max(abs(one.stiffness_n_per_m / other.stiffness_n_per_m - 1) for one, other in pairs)
        channels = max(abs(one.full_scale_m / other.full_scale_m - 1) for one, other in pairs)
        stiffness = now.surface.youngs_modulus_pa / was.surface.youngs_modulus_pa - 1
        mass = now.surface.density_kg_per_m3 / was.surface.density_kg_per_m3 - 1
        parts = [f"stiffness {_percent(stiffness)}, mass {_percent(mass)}, mounts up to {100 * mounts:.1f} % off"]
        if channels > _EQUAL:
            parts.append(f"channels up to {100 * channels:.1f} % off")
        widest = was.spread.finger
        fingers = "as people's are" if widest is None else f"up to {100 * widest:g} % off"
        return f"{', '.join(parts)}; fingers {fingers}, and {1e3 * reach_beside_m(was):g} mm beside"


def _percent(share: float) -> str:
    return f"{round(100 * share, 1) + 0.0:+.1f} %".replace("-", "\N{MINUS SIGN}")


if TYPE_CHECKING:
    from engine.steady.steady_solver import SteadySolver
    from tactable.explain.click_source import ClickSource


@dataclass(frozen=True, eq=False)
class SolvedClick:
    """A click that was solved beside a run, read from the PLAY that carried it.

    weights (function,) of a set of a basis, in steps of 2^-fraction_bits, played at a fraction of full scale.
    """

    basis: Basis
    basis_set: int
    weights: NDArray[np.int16]
    fraction_bits: int
    amplitude: float
    actuators: int

    @classmethod
    def of(cls, play: bytes, basis: Basis | None, actuators: int, halvings: int = 0) -> Self | None:
        """The click of a PLAY without its clock reference; None for one of a set that the basis does not have.

        halvings: how many times the functions of the board's basis are halved.
        """
        if basis is None or not play:
            return None
        _, message = decode_body(encode_play_body(0, play, 0))
        assert isinstance(message, Play)
        if message.basis_set >= len(basis.sets) or len(basis.sets[message.basis_set].actuators) != len(message.weights):
            return None
        weights, amplitude = np.array(message.weights, dtype=np.int16), message.amplitude / FULL_SCALE_WORD
        return cls(basis, message.basis_set, weights, message.fraction_bits + halvings, amplitude, actuators)

    @cached_property
    def samples(self) -> NDArray[np.int16]:
        """Base displacement (sample, actuator) at full amplitude, as the device plays it."""
        sums = weighted_sum(self.basis.sets[self.basis_set], self.weights, self.fraction_bits, self.actuators)
        limits = np.iinfo(np.int16)
        return np.clip(sums, limits.min, limits.max).astype(np.int16)

    @property
    def length_s(self) -> float:
        """Length of the waveform."""
        return (self.basis.sets[self.basis_set].samples - 1) / self.basis.sample_rate_hz


_SILENT = 1e-15  # -300 dB: silence has a logarithm


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
        from engine.steady.steady_solver import SteadySolver

        return SteadySolver(self._table.device, self._table.modes)

    def prepare(self) -> None:
        """Load what promises of clicks take, up to a second."""
        for click in self._table.clicks[:1]:
            self._source.fingers_of(click, click.placement)

    def of_drive(
        self, placement: Placement, level_db: float, held_hz: float | None = None
    ) -> tuple[SteadyDrive, Promise]:
        """The steady drive of a placement, as a run solves it, and its promise.

        held_hz: frequency of the drive that is played; where the fingers moved, it may be that of an earlier one.
        """
        drive = self._solver.solve(placement.position_m, placement.is_felt, level_db, held_hz)
        return drive, self._of_drive(placement, drive)

    def of_row(self, placement: Placement, level_db: float) -> tuple[BestRow, Promise]:
        """The row of the sweep for the zones of the fingers that feel, as a run looks it up, and its promise.

        The row was found on the bar without fingers; the promise is what fingers at these positions get of it. Raises
        TableError for zones without a row.
        """
        row = self._table.best_row(zone_names(self._table.device, placement), level_db)
        return row, self._of_drive(placement, row)

    def _of_drive(self, placement: Placement, drive: SteadyDrive | BestRow) -> Promise:
        """The promise of a drive by finite elements, at its own frequencies.

        Of tones of different frequencies magnitudes add, and levels in power.
        """
        from precompute.model.response import solve_response

        device, position_m = self._table.device, np.array(placement.position_m)
        loaded = self._plant.with_fingers(placement.position_m, device.finger)
        tones_hz, base = np.array(drive.frequencies_hz), drive.complex_amplitudes
        acceleration, weighted = np.zeros((2, len(position_m)))
        for hz in np.unique(tones_hz[base != 0]):
            response = solve_response(loaded, np.array([hz])).acceleration(position_m)[0].T
            reached = abs(response @ np.where(tones_hz == hz, base, 0))
            acceleration = acceleration + reached
            weighted = np.hypot(weighted, reached / device.threshold.peak_m_per_s2(np.array([hz])))
        return Promise(placement, acceleration, 20 * np.log10(np.maximum(weighted, _SILENT)))

    def of_channels(self, placement: Placement, channels: Sequence[ChannelDrive]) -> Array:
        """Levels (finger,) of a steady drive, as a sum of modes: no kernel is loaded. Shape (actuator,): `channels`."""
        tones_hz = [channel.frequency_hz for channel in channels]
        device, modes = self._table.device, self._table.modes
        return standard_levels(device, modes, placement.position_m, tones_hz, _amplitudes(channels))

    def of_tabulated_click(self, placement: Placement, level_db: float) -> tuple[ClickEntry, Promise] | None:
        """The table's click of the nearest places, and its promise; None where the table has none."""
        click = self._table.click_at(placement, level_db)
        return None if click is None else (click, self._promise_of(click, placement))

    def of_click(self, placement: Placement, level_db: float) -> tuple[ClickEntry, Promise]:
        """The same, solved for the places where the table has none; that takes up to a second."""
        click = played_at(self._source.click_of(placement), level_db)
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


class SampledPromises:
    """What sampled bars give to sampled fingers of a placement, from 5th to 95th percentile, in any order of commands.

    They are those that clicks are judged with; fingers lie within `reach_beside_m` of their positions. To make them
    takes up to three seconds, and compiled kernels.
    """

    def __init__(self, table: Table) -> None:
        from tactable.explain.click_source import ClickSource

        self._source = ClickSource(table, reach_beside_m(table.device))
        _ = self._source.solver

    def of(self, placement: Placement, played: ClickEntry | Sequence[ChannelDrive]) -> Array:
        """5th and 95th percentile (2, finger) of the levels that a click or a steady drive (actuator,) gives, dB."""
        if isinstance(played, ClickEntry):
            level_db = self._source.levels_of_click(played, placement)
        else:
            hz = np.array([channel.frequency_hz for channel in played])
            level_db = self._source.levels_of_drive(placement, hz, _amplitudes(played))
        bounds_db: Array = np.percentile(level_db[1:], (5, 95), axis=0)
        return bounds_db


def _amplitudes(channels: Sequence[ChannelDrive]) -> Complex:
    return np.array([cmath.rect(channel.amplitude, channel.phase_rad) for channel in channels])
