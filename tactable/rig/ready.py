"""Tables with which a page plays at once: those that travel with the program, and the first one of any other device.

A *shipped table* holds the best rows of a shipped device and clicks at few places, compressed. Responses and sweeps are
left out, since they are large; modes, which steady drives are solved from, are computed when such a table is unpacked.
The page builds the table on the user's machine meanwhile, compares the clicks with the shipped ones one by one, and
changes over.

It is played only where its device fingerprint is that of the device. The fingerprint of its code may be an older one:
every promise on the page is computed anew from the waveform, by this code, and so is the motion of the bar, and limits
are those of the device. The page then says that the table is older. A test fails where older code made a shipped table.

`python -m tests.tools.ready_tables` makes the shipped tables again.

The *first table* of a device is made in a moment, of modes alone, of which steady drives are solved at once.
A build needs compiled kernels, which take a minute of processor time on a machine that never ran one. The bar's modes
need none. As many are taken as the page's moving bar has, so that the page plays one's own device while kernels are
compiled and the table is built. Such a table has no sweeps, and goes with its run. Once kernels are compiled it has
the best rows of a sweep that is not kept.

It has no clicks either until kernels are compiled. Then one click is solved, which brings the basis that a device must
hold, and a run that plays the table solves the clicks of the placements that are touched, as it does those of three
fingers (`tactable.run.click_process`). Their places and options are those of a table with clicks at few places.
"""

import contextlib
import json
import lzma
import shutil
import zlib
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

from base.files import replace_file, work_folder
from engine.device import Device
from engine.table import Table, TableError
from engine.table.best_rows import write_best_rows
from engine.table.clicks import Clicks
from engine.table.columns import write_clicks, write_modes
from engine.table.netcdf_file import TableWriter
from engine.table.table_diff import compare_tables
from precompute.builder.code_fingerprint import code_fingerprint
from precompute.model.assembly import assemble
from precompute.model.modal import compute_basis
from precompute.sampling.steady_modes import steady_modes
from tactable.shipped import built_paths, ready_folder

if TYPE_CHECKING:
    from precompute.clicks import ClickOptions

GROUPS = ("best_rows", "clicks")  # groups of a shipped table
IS_FIRST = "is_first"  # attribute of a table of modes alone
MODES, MOST_MODES = 24, 60
"""Modes of the page's moving bar, up to 9 kHz: more of them change its levels by less than 0.05 dB. Those of a plate:
3 kHz on a tablet, and more of them change the levels under fingers by less than 0.01 dB."""


def modes_of(device: Device) -> int:
    """Number of modes of the page's moving surface."""
    return MOST_MODES if device.surface.corner_m.imag else MODES


def early_options() -> "ClickOptions":
    """Clicks of tables that are there before the fine ones: few places, so that hundreds of clicks are all."""
    from precompute.clicks import ClickOptions  # it loads kernels

    return ClickOptions(pitch_m=16e-3)


def open_first_table(device: Device, path: Path, *, has_rows: bool = False, has_click: bool = False) -> Table:
    """Make the first table of a device at `path`, and open it; `has_rows` as for `write_first_table`.

    With `has_click` it has its first click, which takes compiled kernels. Raises TableError where it cannot be written.
    """
    write_first_table(device, path, solve_first_click(device) if has_click else None, has_rows=has_rows)
    return Table.open(path, device=device, verify=False)


def solve_first_click(device: Device) -> Clicks:
    """The click of one finger in the middle; where its kernels are not compiled yet, they are."""
    from precompute.clicks import ClickSolver

    places = early_options().places(device.surface.corner_m)
    middle = places.placement((2 * (places.count // 2) + 1,))
    return Clicks.of(places, [ClickSolver(device, early_options().at(places, device.spread)).solve(middle)])


def is_first(table: Table) -> bool:
    """Whether a table has modes alone, and goes with its run."""
    return IS_FIRST in table.attributes


def write_first_table(device: Device, path: Path, clicks: Clicks | None = None, *, has_rows: bool = False) -> None:
    """Write the first table of a device, with what `solve_first_click` gave; what is at `path` is replaced.

    With `has_rows` it has the best rows of the sweep, which takes compiled kernels. Raises TableError where it cannot
    be written.
    """
    basis = compute_basis(assemble(device), modes_of(device))
    modes = steady_modes(basis)
    with TableWriter(path, completes=True) as writer:
        writer.describe(
            {
                "title": f"first table of {device.name}",
                "Conventions": "CF-1.10",
                "device_name": device.name,
                "device_description": device.text,
                "device_fingerprint": device.fingerprint,
                "threshold": device.threshold.title,
                "spread": device.spread_text,
                "code_fingerprint": "",  # it goes with the run
                "code_version": metadata.version("tactable"),
                "created": datetime.now(UTC).isoformat(timespec="seconds"),
                IS_FIRST: 1,
                "modes": modes_of(device),
                **_click_attributes(clicks, modes.places.pitch_m),
            }
        )
        write_modes(writer, modes, device)
        if has_rows:
            from precompute.sweep.tabulate import find_best_rows  # it loads compiled kernels

            if rows := find_best_rows(device):
                write_best_rows(writer, rows, device)
        if clicks is not None:
            write_clicks(writer, clicks, device)


def _click_attributes(clicks: Clicks | None, pitch_m: float) -> dict[str, Any]:
    """How the clicks are solved that a run asks for; without a click `pitch_m` is that of the places."""
    if clicks is None:
        return {"click_pitch_m": pitch_m, "click_tolerance_m": pitch_m / 2}
    return {
        "click_pitch_m": clicks.places.pitch_m,
        "click_tolerance_m": clicks.tolerance_m,
        "click_options": json.dumps(asdict(early_options())),
    }


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
