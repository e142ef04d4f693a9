"""Command `export`: a part of a table as NetCDF, CSV or MATLAB."""

from pathlib import Path
from typing import Annotated

import typer

from base.files import replace_file
from tactable.cli.console import say
from tactable.cli.options import OptionError, TableArgument

_ENDINGS = (".nc", ".csv", ".mat")


def export(
    table_path: TableArgument,
    group: Annotated[
        str,
        typer.Argument(help="sweep, coherent_sweep, best_rows, responses, modes or clicks, as in tables/FORMAT.md."),
    ],
    path: Annotated[Path, typer.Option("-o", "--output", help="The file to write; ends in .nc, .csv or .mat.")],
) -> None:
    """Write a part of a table as NetCDF, CSV or MATLAB.

    NetCDF and MATLAB files hold every array of the part. CSV has a line for each row: of the sweep its two frequencies
    and amplitudes with the figures of every zone, of the clicks one click.
    """
    from tactable.research.notebook_table import Table
    from tactable.research.table_export import write_csv, write_matlab, write_netcdf

    if path.suffix.lower() not in _ENDINGS:
        raise OptionError(f"--output {path}: expected a name that ends in {', '.join(_ENDINGS)}")
    write = {".nc": write_netcdf, ".csv": write_csv, ".mat": write_matlab}[path.suffix.lower()]
    with Table.open(table_path) as table, table.to_xarray(group) as found, replace_file(path) as made:
        names = write(found, group, made)
    say(f"{path}: {group} of {table.device.name}: {', '.join(names)}")
