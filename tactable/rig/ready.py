"""Tables that travel with the program, so that a page plays at once: made, unpacked, and compared with one built here.

A shipped table holds the best rows of a shipped device and clicks at few places, compressed. Responses and
sweeps are left out, since they are large; modes, which steady drives are solved from, are computed when such a table is
unpacked. The page builds the table on the user's machine meanwhile, compares the clicks with
the shipped ones one by one, and changes over.

It is played only where its device fingerprint is that of the device. The fingerprint of its code may be an older one:
every promise on the page is computed anew from the waveform, by this code, and so is the motion of the bar, and limits
are those of the device. The page then says that the table is older. A test fails where older code made a shipped table.

`python -m tests.tools.ready_tables` makes the shipped tables again.
"""

import contextlib
import lzma
import shutil
import zlib
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from base.files import replace_file, work_folder
from engine.device import Device
from engine.table import Table, TableError
from engine.table.columns import write_modes
from engine.table.netcdf_file import TableWriter
from engine.table.table_diff import compare_tables
from precompute.builder.code_fingerprint import code_fingerprint
from precompute.model.assembly import assemble
from precompute.model.modal import compute_basis
from precompute.sampling.steady_modes import steady_modes
from tactable.rig.first_table import modes_of
from tactable.shipped import built_paths, ready_folder

GROUPS = ("best_rows", "clicks")  # groups of a shipped table


def cached_table(device: Device, folder: Path) -> Path:
    """Path of the cached table of a device."""
    return folder / f"{device.name}-{device.fingerprint[:12]}.nc"


def take_built(device: Device, device_file: Path, folder: Path) -> Path | None:
    """Copy the table that `tactable build` made of a device file into the cache `folder`, and return its path there.

    Looked for are the working folder and that of the device file. The table must be of this device and this code, and
    have clicks; None: there is no such table.
    """
    cached = cached_table(device, folder)
    for path in built_paths(device, device_file):
        with contextlib.suppress(TableError):
            if path.is_file():
                with Table.open(path, device=device, code_fingerprint=code_fingerprint(), verify=False) as table:
                    if not table.clicks:
                        continue
                cached.parent.mkdir(parents=True, exist_ok=True)
                cached.unlink(missing_ok=True)  # its permissions are not those of the user's file
                with replace_file(cached) as partial:
                    try:
                        partial.hardlink_to(path)
                    except OSError:  # the cache lies on another disk
                        shutil.copyfile(path, partial)
                return path
    return None


def early_path(path: Path) -> Path:
    """Path of a table while it has the clicks of few places."""
    return path.with_name(f"{path.stem}-early{path.suffix}")


def open_cached(device: Device, path: Path) -> Table | None:
    """The table at `path`, else the early one beside it, else the shipped one; None where none is of this device.

    All but the shipped one must be of this code, too.
    """
    for each in (path, early_path(path)):
        with contextlib.suppress(TableError):
            if each.is_file():  # the fingerprint of the code takes half a second
                return Table.open(each, device=device, code_fingerprint=code_fingerprint(), verify=False)
    return open_shipped(device, path)


def open_shipped(device: Device, path: Path) -> Table | None:
    """Open the shipped table of a device, which is unpacked beside `path` first.

    None: no table is shipped for this device, or it has another format.
    """
    packed = packed_path(device.name)
    if not packed.is_file():
        return None
    content = packed.read_bytes()
    unpacked = path.with_name(f"{path.stem}-shipped-{zlib.crc32(content):08x}{path.suffix}")
    with contextlib.suppress(TableError):
        return Table.open(unpacked, device=device, verify=False)
    unpacked.parent.mkdir(parents=True, exist_ok=True)
    with contextlib.suppress(TableError):
        _unpack(lzma.decompress(content), device, unpacked)
        return Table.open(unpacked, device=device, verify=False)
    return None


def _unpack(packed: bytes, device: Device, path: Path) -> None:
    """Write a shipped table with modes at `path`; raises TableError where it is of another device or format."""
    with work_folder("unpack") as folder:
        small = folder / "small.nc"
        small.write_bytes(packed)
        with Table.open(small, device=device) as table, TableWriter(path, completes=True) as writer:
            writer.describe(plain_attributes(table))
            table.copy_groups(writer, GROUPS)
            write_modes(writer, steady_modes(compute_basis(assemble(device), modes_of(device))), device)


def plain_attributes(table: Table) -> dict[str, Any]:
    """Attributes of a table that one made of it keeps."""
    kept = {key: value for key, value in table.attributes.items() if not key.startswith(("_", "format"))}
    return {key: value.item() if hasattr(value, "item") else value for key, value in kept.items()}


def is_outdated(table: Table) -> bool:
    """Whether a table was made by other code than this."""
    return bool(table.attributes["code_fingerprint"] != code_fingerprint())


def packed_path(device_name: str) -> Path:
    """Path of the packed table that is shipped for a device."""
    return ready_folder() / f"{device_name}.nc.xz"


@dataclass(frozen=True)
class Comparison:
    """A table that was built here beside the shipped one: counts of what is in both and of what differs audibly.

    Another processor rounds otherwise, and where two clicks are as good it may find the other one. most_db: the
    greatest difference of a level; None where one of the tables lacks a click.
    """

    clicks: int
    changed: int
    most_db: float | None

    @property
    def text(self) -> str:
        """The result in a sentence."""
        if not self.changed:
            return f"all {self.clicks} clicks are as shipped, within 0.1 dB"
        most = "some are missing" if self.most_db is None else f"levels by up to {self.most_db:.1f} dB"
        return f"{self.changed} of {self.clicks} clicks differ from the shipped ones, {most}"

    def as_json(self) -> dict[str, Any]:
        """The counts, and the sentence."""
        return {**asdict(self), "text": self.text}


def compare_with_shipped(shipped: Table, built: Table) -> Comparison:
    """Compare click by click."""
    found = compare_tables(shipped, built).clicks
    alone = len(found.vanished) + len(found.appeared)
    sizes_db = [figure.size for click in found.changed for figure in click.figures if figure.unit == "dB"]
    return Comparison(found.compared, len(found.changed) + alone, None if alone else max(sizes_db, default=0.0))
