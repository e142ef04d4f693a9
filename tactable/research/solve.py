"""Clicks and steady drives for fingers on a device, solved now and without a table."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import inf
from typing import TYPE_CHECKING

from engine.device import Device
from engine.steady import SteadyDrive
from engine.table import ClickEntry
from engine.table.click import LevelSpread, played_at
from engine.table.levels import DEFAULT_LEVEL_DB
from engine.touch import Placement
from engine.touch.placement import PlacementError
from tactable.research.played import click_dataset, drive_dataset

if TYPE_CHECKING:
    import xarray
    from numpy import float64
    from numpy.typing import NDArray

    from precompute.clicks import ClickSolver
    from precompute.predict.at_positions import Percentiles, PlacementFigures, SteadyDesigner


@dataclass(frozen=True, eq=False)
class SolvedClick:
    """A click that was solved for fingers, each within a millimetre of its position.

    entry: as a table holds it, played at the level that was asked for; processor_s: what solving it took.
    """

    device: Device
    placement: Placement
    entry: ClickEntry
    processor_s: float

    @property
    def waveform(self) -> "NDArray[float64]":
        """Base displacement (time, actuator) as a fraction of full scale, linear between samples."""
        from tactable.explain.click_course import played_displacement

        return played_displacement(self.entry)

    @property
    def weights(self) -> "NDArray[float64]":
        """Weights (function,) of the device's basis, as a PLAY carries them."""
        found: NDArray[float64] = self.entry.weights.astype("f8") * (
            self.entry.amplitude * 2.0**-self.entry.fraction_bits
        )
        return found

    @property
    def felt(self) -> LevelSpread:
        """Level of the weakest felt finger over sampled plants that it was not made with, dB above threshold."""
        return self.entry.felt

    @property
    def quiet(self) -> LevelSpread | None:
        """Level of the strongest quiet finger; None where nothing is quiet."""
        return self.entry.quiet

    def to_xarray(self) -> "xarray.Dataset":
        """Waveform and promises, as `tactable.research.played.Click.to_xarray`."""
        return click_dataset(self.device, self.entry, self.placement)

    def __repr__(self) -> str:
        from tactable.explain.words import placement_text

        quiet = "" if self.quiet is None else f", quiet {self.quiet.high_db:.1f} dB (95 %)"
        levels = f"felt {self.felt.low_db:.1f} dB (5 %){quiet}, {self.device.threshold.above}"
        return f"<SolvedClick {placement_text(self.device, self.placement)}: {levels}; {1e3 * self.processor_s:.1f} ms>"


@dataclass(frozen=True, eq=False)
class SolvedDrive:
    """A steady drive that was solved for fingers, as a run solves it, with what sampled fingers get of it."""

    device: Device
    placement: Placement
    figures: "PlacementFigures"
    processor_s: float
    """Of the drive alone, without its figures."""

    @property
    def drive(self) -> SteadyDrive:
        """Frequency, amplitudes and phases."""
        return self.figures.drive

    @property
    def felt(self) -> "Percentiles":
        """Level of the weakest felt finger over sampled fingers and bars, dB above threshold."""
        return self.figures.spread.felt

    @property
    def quiet(self) -> "Percentiles | None":
        """Level of the strongest quiet finger; None where nothing is quiet."""
        return self.figures.spread.quiet

    def to_xarray(self) -> "xarray.Dataset":
        """The drive and its levels, as `tactable.research.played.Drive.to_xarray`."""
        return drive_dataset(self.device, self.drive, self.placement)

    def __repr__(self) -> str:
        from tactable.explain.words import placement_text

        quiet = "" if self.quiet is None else f", quiet {self.quiet.high_db:.1f} dB (95 %)"
        levels = f"felt {self.felt.low_db:.1f} dB (5 %){quiet}, {self.device.threshold.above}"
        return (
            f"<SolvedDrive {placement_text(self.device, self.placement)}: {self.drive.frequency_hz:.1f} Hz, {levels}>"
        )


def solve_click(
    device: Device, felt: Sequence[str | float], quiet: Sequence[str | float] = (), level_db: float = inf
) -> SolvedClick:
    """Solve the click for up to ten fingers where they are; infinite `level_db`: as strong as it can be.

    A position is a text such as "35 mm", metres, or the name of a zone, which means its middle. The first click of a
    device also samples its plants, which takes a fraction of a second. Raises PlacementError for positions that are no
    placement, and where no finger is felt.

    >>> click = solve_click(device, felt=["35 mm"], quiet=["120 mm", "200 mm"])
    >>> click.waveform.shape
    (121, 2)
    """
    placement, solver = _felt_placement(device, felt, quiet), _click_solver(device)
    start_s = time.process_time()
    entry = solver.solve_entry(placement)
    return SolvedClick(device, placement, played_at(entry, level_db), time.process_time() - start_s)


def solve_drive(
    device: Device,
    felt: Sequence[str | float],
    quiet: Sequence[str | float] = (),
    level_db: float = DEFAULT_LEVEL_DB,
) -> SolvedDrive:
    """Solve the steady drive for fingers where they are, given as in `solve_click`, at a level in dB.

    >>> solve_drive(device, felt=["35 mm"], quiet=["120 mm"], level_db=20).drive.achieved
    True
    """
    placement, designer = _felt_placement(device, felt, quiet), _designer(device)
    start_s = time.process_time()
    designer.solver.solve(placement.position_m, placement.is_felt, level_db)
    processor_s = time.process_time() - start_s
    figures = designer.solve(placement.position_m, placement.is_felt, level_db)
    return SolvedDrive(device, placement, figures, processor_s)


def _felt_placement(device: Device, felt: Sequence[str | float], quiet: Sequence[str | float]) -> Placement:
    if not felt:
        raise PlacementError('no finger is felt: name at least one, such as felt=["35 mm"]')
    return Placement.named(device, felt, quiet)


@lru_cache(maxsize=4)
def _click_solver(device: Device) -> "ClickSolver":
    from precompute.clicks import DEFAULT_OPTIONS, ClickSolver

    return ClickSolver(device, DEFAULT_OPTIONS.at_fingers)


@lru_cache(maxsize=4)
def _designer(device: Device) -> "SteadyDesigner":
    from precompute.predict.at_positions import SteadyDesigner

    return SteadyDesigner(device)
