"""Parts of a table for other programs: a NetCDF file of one part, a MATLAB file, or lines of CSV."""

from collections.abc import Hashable, Iterator
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import pandas
    import xarray

ROWS = {
    "sweep": ("pair", "frequency_1", "amplitude_1", "amplitude_2", "frequency_2"),
    "coherent_sweep": ("pair", "frequency", "ratio", "phase"),
    "best_rows": ("level", "combination"),
    "responses": ("frequency", "actuator", "zone", "point"),
    "modes": ("function", "actuator", "frequency"),
    "clicks": ("click",),
}
"""Dimensions whose elements are the rows of the CSV; the others are columns. Arrays of neither are left out."""


def write_netcdf(found: "xarray.Dataset", group: str, path: Path) -> list[str]:
    """Write a part with its units at the root of a NetCDF-4 file; returns the names of its arrays."""
    plain = found.assign_attrs(group=group).drop_encoding()
    for array in plain.variables.values():
        array.attrs.pop("crc32", None)  # of the table's bytes
    plain.to_netcdf(path, engine="h5netcdf", format="NETCDF4")
    return _names(found)


def write_matlab(found: "xarray.Dataset", group: str, path: Path) -> list[str]:
    """Write a struct named `group` into a MATLAB file (version 5): arrays in the table's order, texts as cells.

    Its field `units` has the unit of each array. Returns the names of the arrays.
    """
    from scipy.io import savemat

    arrays: dict[str, Any] = {}
    for name, array in found.variables.items():
        values = np.asarray(array.values)
        arrays[str(name)] = values.astype(object) if values.dtype.kind in "OU" else values
    units = {str(name): str(array.attrs.get("units", "1")) for name, array in found.variables.items()}
    fields = {group: {**arrays, "units": units}}
    savemat(str(path), fields, appendmat=False, long_field_names=True, oned_as="column")
    return _names(found)


def write_csv(found: "xarray.Dataset", group: str, path: Path) -> list[str]:
    """Write a line for each element of `ROWS`, its labels first; returns the names of the arrays that are in it."""
    rows, found = ROWS[group], _with_points(found) if group == "clicks" else found
    kept = found[[name for name in _names(found) if _is_by_row(set(found[name].dims), set(rows))]]
    with path.open("w", newline="", encoding="utf-8") as file:
        for number, part in enumerate(_parts(kept, rows[:-2])):  # a part at a time: a sweep does not fill the memory
            _frame(part, rows).to_csv(file, header=number == 0, index=False)
    return _names(kept)


def _with_points(clicks: "xarray.Dataset") -> "xarray.Dataset":
    """Clicks with the points of their fingers, m, which a table has by the index of a place; NaN behind the last."""
    index = clicks["finger_place"]
    for name in ("place", "place_across"):
        if name in clicks.variables:
            at_m = np.append(clicks[name].values, np.nan)[index.values]  # NO_FINGER is -1
            clicks = clicks.assign({name.replace("place", "finger_position"): (index.dims, at_m)})
    return clicks


def _names(found: "xarray.Dataset") -> list[str]:
    return [str(name) for name in found.data_vars]


def _is_by_row(dimensions: set[Hashable], rows: set[str]) -> bool:
    """Whether every row has a value, or some, of an array with these dimensions."""
    return rows <= dimensions or (bool(dimensions) and dimensions <= rows)


def _parts(found: "xarray.Dataset", outer: tuple[str, ...]) -> Iterator["xarray.Dataset"]:
    """The dataset at each element of the `outer` dimensions, which stay, with one element."""
    for at in product(*(range(found.sizes[name]) for name in outer)):
        yield found.isel({name: [index] for name, index in zip(outer, at, strict=True)})


def _frame(part: "xarray.Dataset", rows: tuple[str, ...]) -> "pandas.DataFrame":
    """The rows of a dataset: labels, then a column for each array and each element of its other dimensions."""
    import pandas

    labels = np.meshgrid(*(part[name].values for name in rows), indexing="ij")
    columns = {name: each.ravel() for name, each in zip(rows, labels, strict=True)}
    for name in _names(part):
        others = [str(each) for each in part[name].dims if each not in rows]
        whole = part[name].broadcast_like(part[list(rows)])
        values = whole.transpose(*rows, *others).values.reshape(columns[rows[0]].size, -1)
        places = product(*(part[each].values for each in others))
        columns |= {" ".join(map(str, (name, *place))): values[:, at] for at, place in enumerate(places)}
    return pandas.DataFrame(columns)
