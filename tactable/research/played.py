"""Output of a table for fingers at positions: a steady drive or a click, with pictures and labelled arrays."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, fields
from html import escape
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from engine.device import Device
from engine.steady import SteadyDrive
from engine.table import ClickEntry, Table
from engine.touch import Placement

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure


_SPREAD = ("nominal", "5 %", "50 %", "95 %", "worst")


@dataclass(frozen=True)
class _Asked(ABC):
    """Something that was asked of a table for some positions."""

    table: Table = field(kw_only=True, repr=False)
    asked: Placement = field(kw_only=True)

    @classmethod
    def of(cls, found: Any, table: Table, asked: Placement) -> Self:
        """`found` with its table and the placement that it was asked for."""
        return cls(**{each.name: getattr(found, each.name) for each in fields(found)}, table=table, asked=asked)

    def _words(self) -> str:
        """The fingers that it was asked for."""
        from tactable.explain.words import placement_text

        return placement_text(self.table.device, self.asked)

    @abstractmethod
    def _summary(self) -> list[tuple[str, str]]:
        """Short description: names and values."""

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self._words()}: {'; '.join(' '.join(row) for row in self._summary())}>"

    def _repr_html_(self) -> str:
        rows = "".join(f"<tr><td>{escape(k)}</td><td>{escape(v)}</td></tr>" for k, v in self._summary())
        return f"<b>{type(self).__name__}</b> {escape(self._words())}<table>{rows}</table>"


@dataclass(frozen=True, repr=False)
class Drive(_Asked, SteadyDrive):
    """A steady drive solved for the positions of the fingers, as a run solves it (engine.steady.solver)."""

    def plot(self) -> "Figure":
        """Picture of the drive: level along the bar and under every finger, over sampled fingers."""
        from tactable.figures.played_drive import solved_drive
        from tactable.figures.state import plot_state

        return plot_state(solved_drive(self.table, self.asked, self.wanted_level_db)).figure

    def to_xarray(self) -> "xarray.Dataset":
        """Frequency, amplitude and phase (actuator), level (finger), and sampled_level (case, finger) in dB."""
        return drive_dataset(self.table.device, self, self.asked)

    def _summary(self) -> list[tuple[str, str]]:
        names = [actuator.name for actuator in self.table.device.actuators]
        outputs = zip(names, self.amplitudes, self.phases_rad, strict=True)
        contrast_db, first = self.expected_contrast_db, self.phases_rad[0]
        rows = [
            (name, f"{self.frequency_hz:.2f} Hz, {100 * size:.1f} %, {np.degrees(phase - first) % 359.995:.0f}°")
            for name, size, phase in outputs
        ]
        rows.append(("felt", f"{self.weakest_felt_db:.1f} dB{'' if self.achieved else ', NOT ACHIEVED'}"))
        return rows + ([] if contrast_db is None else [("expected contrast", f"{contrast_db:.1f} dB")])


@dataclass(frozen=True, eq=False, repr=False)
class Click(_Asked, ClickEntry):
    """The click that a table has for the nearest places (engine.table.click)."""

    def plot(self) -> "Figure":
        """Picture of the waveform and of what every finger feels of it, over fresh plants; takes a second."""
        from tactable.explain.click_source import ClickSource
        from tactable.figures.click import plot_click

        return plot_click(ClickSource(self.table), self, self.asked).figure

    def to_xarray(self) -> "xarray.Dataset":
        """The waveform (time, actuator) as played, fractions of full scale; felt_level and quiet_level (spread) in dB.

        The levels are promised for fingers within the table's tolerance of its places. quiet_level is NaN where
        nothing is quiet.
        """
        return click_dataset(self.table.device, self, self.asked)

    def _summary(self) -> list[tuple[str, str]]:
        places = " and ".join(f"{1e3 * at_m:.4g}" for at_m in self.placement.position_m)
        rows = [
            ("length", f"{1e3 * self.length_s:g} ms"),
            ("made for", f"{places} mm, each finger within {1e3 * self.tolerance_m:.3g} mm"),
            ("felt", f"{self.felt.low_db:.1f} dB (5 %){'' if self.achieved else ', NOT ACHIEVED'}"),
        ]
        return rows + ([] if self.quiet is None else [("quiet", f"{self.quiet.high_db:.1f} dB (95 %)")])


def click_dataset(device: Device, click: ClickEntry, asked: Placement) -> "xarray.Dataset":
    """The waveform (time, actuator) of a click as played, and its promises; asked: the fingers."""
    import xarray

    from tactable.explain.click_course import played_displacement

    rate_hz, waveform = click.sample_rate_hz, played_displacement(click)
    felt, quiet = ([np.nan] * 5 if each is None else _levels(each) for each in (click.felt, click.quiet))
    return xarray.Dataset(
        {
            "waveform": (("time", "actuator"), waveform, {"units": "1", "long_name": "fraction of full scale"}),
            "felt_level": ("spread", felt, {"units": "dB", "long_name": "weakest felt finger"}),
            "quiet_level": ("spread", quiet, {"units": "dB", "long_name": "strongest quiet finger"}),
        },
        {
            "time": ("time", np.arange(len(waveform)) / rate_hz, {"units": "s"}),
            "actuator": [actuator.name for actuator in device.actuators],
            "spread": list(_SPREAD),
            **_fingers(asked),
            "place": ("finger", list(click.placement.position_m), {"units": "m", "long_name": "made for"}),
        },
        {**_origin(device), "tolerance_m": click.tolerance_m, "achieved": int(click.achieved)},
    )


def drive_dataset(device: Device, drive: SteadyDrive, asked: Placement) -> "xarray.Dataset":
    """Frequency, amplitude and phase of every actuator, and the levels; asked: the fingers."""
    import xarray

    names = [actuator.name for actuator in device.actuators]
    level = {"units": "dB", "long_name": f"{device.threshold.above}, standard finger"}
    return xarray.Dataset(
        {
            "frequency": ("actuator", list(drive.frequencies_hz), {"units": "Hz"}),
            "amplitude": ("actuator", list(drive.amplitudes), {"units": "1", "long_name": "of full scale"}),
            "phase": ("actuator", list(drive.phases_rad), {"units": "rad"}),
            "level": ("finger", drive.level_db, level),
            "sampled_level": (("case", "finger"), drive.sampled_level_db, {"units": "dB"}),
        },
        {"actuator": names, **_fingers(asked)},
        {**_origin(device), "wanted_level_db": drive.wanted_level_db, "achieved": int(drive.achieved)},
    )


def _fingers(asked: Placement) -> dict[str, Any]:
    """Coordinates of the fingers that were asked for."""
    return {
        "position": ("finger", list(asked.position_m), {"units": "m"}),
        "is_felt": ("finger", list(asked.is_felt)),
    }


def _origin(device: Device) -> dict[str, str]:
    from tactable.research.bar import origin_of

    return {**origin_of(device), "threshold": device.threshold.title}


def _levels(spread: Any) -> list[float]:
    return [spread.nominal_db, spread.low_db, spread.middle_db, spread.high_db, spread.worst_db]
