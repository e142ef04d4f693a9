"""Makes the tables that travel with the program.

python -m tests.tools.ready_tables [DEVICE...]
"""

import lzma
import sys
from pathlib import Path

from base.files import work_folder
from engine.table import Table
from engine.table.netcdf_file import TableWriter
from engine.table.schema import IS_SHIPPED
from precompute.builder.table_build import build_table
from precompute.parallel.pool import available_cores
from tactable.rig.ready import GROUPS, early_options, packed_path, plain_attributes
from tactable.shipped import find_device, ready_folder, shipped_names

REMAKE = "python -m tests.tools.ready_tables"


def pack(built: Table, path: Path) -> None:
    with work_folder("pack") as folder:
        small = folder / "small.nc"
        with TableWriter(small) as writer:
            writer.describe({**plain_attributes(built), IS_SHIPPED: 1})
            built.copy_groups(writer, GROUPS)
        path.write_bytes(lzma.compress(small.read_bytes(), preset=9 | lzma.PRESET_EXTREME))


def main(names: list[str]) -> None:
    """Make the shipped tables of these devices again, by default of all."""
    ready_folder().mkdir(exist_ok=True)
    for name in names or shipped_names():
        device = find_device(name)
        with work_folder("pack") as folder:
            path = folder / "built.nc"
            build_table(device, path, click_options=early_options(), workers=available_cores())
            with Table.open(path, device=device) as built:
                pack(built, packed_path(name))
        sys.stdout.write(f"{packed_path(name)}: {packed_path(name).stat().st_size / 1e6:.2f} MB\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main(sys.argv[1:])
