"""Objects of a notebook: a table, and steady drives and clicks for fingers, with pictures and labelled arrays."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from html import escape
from math import isnan
from numbers import Complex, Real
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from base.points import point_text
from engine.device import Device
from engine.steady import SteadyDrive
from engine.table import ClickEntry, TableError
from engine.table import Table as TableFile
from engine.table.levels import DEFAULT_LEVEL_DB
from engine.touch import Placement
from engine.touch.placement import PlacementError

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure

_SPREAD = ("nominal", "5 %", "50 %", "95 %", "worst")


def asked_placement(
    device: Device, felt: Sequence[str | complex], quiet: Sequence[str | complex], level_db: float
) -> Placement:
    """The placement of these fingers. Raises PlacementError if they are no list of positions or the level no number."""
    for role, fingers in (("felt", felt), ("quiet", quiet)):
        if isinstance(fingers, Complex):
            raise PlacementError(f"{role}={fingers!r}: is one position; give a list, such as [{fingers!r}]")
        for each in fingers:
            if not isinstance(each, str | Complex):
                raise PlacementError(f"{role}: {each!r}: expected a text such as '35 mm', metres or the name of a zone")
    if not isinstance(level_db, Real) or isnan(level_db):
        raise PlacementError(f"level_db={level_db!r}: expected a number of dB above the threshold, such as 20")
    return Placement.named(device, felt, quiet)


@dataclass(frozen=True)
class _Asked(ABC):
    """A drive or click and the finger positions that it was asked for.

    table: where it was looked up; None where it was solved from a device alone.
    """

    device: Device = field(kw_only=True, repr=False)
    asked: Placement = field(kw_only=True)
    table: TableFile | None = field(kw_only=True, repr=False, default=None)

    @classmethod
    def of(cls, found: Any, device: Device, asked: Placement, table: TableFile | None = None) -> Self:
        """`found` with its device, the placement that it was asked for, and its table."""
        own = {each.name: getattr(found, each.name) for each in fields(found)}
        return cls(**own, device=device, asked=asked, table=table)

    def _words(self) -> str:
        """The fingers that it was asked for."""
        from tactable.explain.words import placement_text

        return placement_text(self.device, self.asked)

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
    """A steady drive solved for the positions of the fingers, as a run solves it (engine.steady.steady_solver)."""

    @property
    def contrast_db(self) -> float | None:
        """Level of the weakest felt finger less the level of the strongest quiet one, in dB.

        None without a quiet finger. Levels are of standard fingers exactly in place, where the model's null may be
        deeper than any bar's; `expected_contrast_db` is over sampled fingers.
        """
        quiet = [level for level, is_felt in zip(self.level_db, self.felt, strict=True) if not is_felt]
        return float(self.weakest_felt_db - max(quiet)) if quiet else None

    def plot(self) -> "Figure":
        """Picture of the drive: level along the bar and under every finger, over sampled fingers."""
        from precompute.predict.at_positions import SteadyDesigner
        from tactable.explain.placed_drive import designer_of
        from tactable.figures.state_picture import plot_state, solved_drive

        designer = SteadyDesigner(self.device) if self.table is None else designer_of(self.table)
        return plot_state(solved_drive(designer, self.asked, self.wanted_level_db)).figure

    def to_xarray(self) -> "xarray.Dataset":
        """Frequency, amplitude and phase (actuator), level (finger), and sampled_level (case, finger) in dB."""
        import xarray

        names = [actuator.name for actuator in self.device.actuators]
        level = {"units": "dB", "long_name": f"{self.device.threshold.above}, standard finger"}
        return xarray.Dataset(
            {
                "frequency": ("actuator", list(self.frequencies_hz), {"units": "Hz"}),
                "amplitude": ("actuator", list(self.amplitudes), {"units": "1", "long_name": "of full scale"}),
                "phase": ("actuator", list(self.phases_rad), {"units": "rad"}),
                "level": ("finger", self.level_db, level),
                "sampled_level": (("case", "finger"), self.sampled_level_db, {"units": "dB"}),
            },
            {"actuator": names, **_fingers(self.asked)},
            {**_origin(self.device), "wanted_level_db": self.wanted_level_db, "achieved": int(self.achieved)},
        )

    def _summary(self) -> list[tuple[str, str]]:
        names = [actuator.name for actuator in self.device.actuators]
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
    """The click that a table has for the nearest places, or one that was solved (engine.table.clicks)."""

    def plot(self) -> "Figure":
        """Picture of the waveform and of what every finger feels of it, over fresh plants; takes a second.

        Raises TableError for a click that was solved without a table.
        """
        from tactable.explain.click_source import ClickSource
        from tactable.figures.click_picture import plot_click

        if self.table is None:
            raise TableError(f"{self.device.name}: this click was solved without a table; build one to draw its clicks")
        return plot_click(ClickSource(self.table), self, self.asked).figure

    def to_xarray(self) -> "xarray.Dataset":
        """The waveform (time, actuator) as played, fractions of full scale; felt_level and quiet_level (spread) in dB.

        Levels are promised for fingers within the tolerance of its places. quiet_level is NaN where nothing is quiet.
        """
        import xarray

        waveform = self.waveform
        felt, quiet = ([np.nan] * 5 if each is None else _levels(each) for each in (self.felt, self.quiet))
        return xarray.Dataset(
            {
                "waveform": (("time", "actuator"), waveform, {"units": "1", "long_name": "fraction of full scale"}),
                "felt_level": ("spread", felt, {"units": "dB", "long_name": "weakest felt finger"}),
                "quiet_level": ("spread", quiet, {"units": "dB", "long_name": "strongest quiet finger"}),
            },
            {
                "time": ("time", np.arange(len(waveform)) / self.sample_rate_hz, {"units": "s"}),
                "actuator": [actuator.name for actuator in self.device.actuators],
                "spread": list(_SPREAD),
                **_fingers(self.asked),
                **_points("place", self.placement.position_m, long_name="made for"),
            },
            {**_origin(self.device), "tolerance_m": self.tolerance_m, "achieved": int(self.achieved)},
        )

    def _summary(self) -> list[tuple[str, str]]:
        places = " and ".join(point_text(at_m, 4) for at_m in self.placement.position_m)
        rows = [
            ("length", f"{1e3 * self.length_s:g} ms"),
            ("made for", f"{places}, each finger within {1e3 * self.tolerance_m:.3g} mm"),
            ("felt", f"{self.felt.low_db:.1f} dB (5 %){'' if self.achieved else ', NOT ACHIEVED'}"),
        ]
        return rows + ([] if self.quiet is None else [("quiet", f"{self.quiet.high_db:.1f} dB (95 %)")])


def _fingers(asked: Placement) -> dict[str, Any]:
    """Coordinates of the fingers that were asked for."""
    return {**_points("position", asked.position_m), "is_felt": ("finger", list(asked.is_felt))}


def _points(name: str, points: Sequence[complex], **attributes: str) -> dict[str, Any]:
    """A coordinate of the fingers in metres, and on a plate another for how far across it they lie."""
    at_m = np.array(points)
    found = {name: at_m.real} | ({f"{name}_across": at_m.imag} if np.iscomplexobj(at_m) else {})
    return {key: ("finger", part, {"units": "m", **attributes}) for key, part in found.items()}


def origin_of(device: Device) -> dict[str, str]:
    """Attributes that say what an array was computed from."""
    estimates = ", ".join(device.estimated_values)
    return {"device": device.name, "device_fingerprint": device.fingerprint, "source": "model", "estimates": estimates}


def _origin(device: Device) -> dict[str, str]:
    return {**origin_of(device), "threshold": device.threshold.title}


def _levels(spread: Any) -> list[float]:
    return [spread.nominal_db, spread.low_db, spread.middle_db, spread.high_db, spread.worst_db]


class Table(TableFile):
    """An open table (engine.table.Table); `Table.open` makes one, as a context manager."""

    def click_for(
        self, felt: Sequence[str | complex], quiet: Sequence[str | complex] = (), level_db: float = DEFAULT_LEVEL_DB
    ) -> Click:
        """Click of the nearest places for fingers at these positions, played at `level_db`.

        A position is a text such as "35 mm", metres, or the name of a zone, which means its middle. Raises
        PlacementError for positions that are no placement, TableError where it has no click for this number of fingers.

        >>> with Table.open("my-bar.nc") as table:
        ...     table.click_for(["35 mm"]).to_xarray().waveform.dims
        ('time', 'actuator')
        """
        placement = asked_placement(self.device, felt, quiet, level_db)
        return Click.of(super().click_for(felt, quiet, level_db), self.device, placement, self)

    def drive_for(
        self, felt: Sequence[str | complex], quiet: Sequence[str | complex] = (), level_db: float = DEFAULT_LEVEL_DB
    ) -> Drive:
        """Steady drive solved for fingers at these positions, given as in `click_for`.

        Raises PlacementError, and SteadyError where no finger is felt.

        >>> with Table.open("my-bar.nc") as table:
        ...     table.drive_for(felt=["35 mm"], quiet=["120 mm"]).achieved
        True
        """
        placement = asked_placement(self.device, felt, quiet, level_db)
        return Drive.of(super().drive_for(felt, quiet, level_db), self.device, placement, self)

    def to_xarray(self, group: str = "responses") -> "xarray.Dataset":
        """One group of the file (tables/FORMAT.md), on demand. Raises TableError for a group that is not there.

        >>> with Table.open("my-bar.nc") as table:
        ...     table.to_xarray("sweep").localized_factor.attrs["units"]
        '1'
        """
        import xarray

        groups = sorted(self._file.groups)
        if group not in groups:
            why = f" ({self.no_sweep_text})" if group.endswith("sweep") else ""
            raise TableError(f"{self.path}: has no group {group!r}; its groups are {', '.join(groups)}{why}")
        found = xarray.open_dataset(self.path, group=group, engine="h5netcdf")
        return found.assign_attrs(threshold=self.device.threshold.title)

    def _summary(self) -> str:
        clicks = f"{len(self.clicks)} clicks at places {1e3 * self.places.pitch_m:.3g} mm apart"
        return f"{self.device.name}, {clicks}, best rows of {len(self.best_rows)} zone combinations"

    def __repr__(self) -> str:
        return f"<Table {self.path}: {self._summary()}>"

    def _repr_html_(self) -> str:
        return f"<b>Table</b> {escape(str(self.path))}: {escape(self._summary())}"
