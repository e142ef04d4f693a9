"""A table in a notebook: what it plays as objects with pictures and labelled arrays, and its groups as datasets."""

from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING

from engine.table import Table as TableFile
from engine.table import TableError
from engine.table.levels import DEFAULT_LEVEL_DB
from tactable.research.played import Click, Drive, asked_placement

if TYPE_CHECKING:
    import xarray


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
