"""Files that travel with the program, by name: devices, their tables, the demo's recording; and the cache folder."""

import os
from pathlib import Path
from typing import TYPE_CHECKING

from base.files import shipped

if TYPE_CHECKING:  # device files need the units of pint, which `tactable list` does not
    from engine.device import Device
    from engine.effects.rules import Effect

_HERE = Path(__file__).parent
DEMO_RECORDING = _HERE / "rig" / "demo.hid"


def device_folder() -> Path:
    """Folder of the shipped descriptions."""
    return shipped(_HERE, "devices")


def ready_folder() -> Path:
    """Folder of the shipped tables (tactable.rig.ready)."""
    return shipped(_HERE, "ready")


def shipped_names() -> list[str]:
    """Names of the shipped devices."""
    return sorted(path.stem for path in device_folder().glob("*.toml"))


def named_effects() -> "dict[str, Effect]":
    """The effects of the vocabulary that rule files and programs may name."""
    from engine.effects.rule_file import read_vocabulary

    return read_vocabulary(shipped(_HERE, "vocabulary.toml"))


def new_text(surface: str) -> str:
    """Text of the device file that `tactable new` begins with; surface: "bar" or "plate"."""
    return shipped(_HERE, f"new-{surface}.toml").read_text(encoding="utf-8")


def find_device(name_or_path: str) -> "Device":
    """Read a device by file path or by shipped name. Raises DeviceError with the known names."""
    from engine.device import Device

    return Device.read(find_device_file(name_or_path))


def find_device_file(name_or_path: str) -> Path:
    """Find the file of a device by path or by shipped name. Raises DeviceError with the known names."""
    path = Path(name_or_path)
    if path.is_file():
        refuse_table(path)
        return path
    if name_or_path not in shipped_names():
        from engine.device import DeviceError

        known = ", ".join(shipped_names())
        raise DeviceError(f"{name_or_path}: is neither a file nor a shipped device; shipped are {known}")
    return device_folder() / f"{name_or_path}.toml"


def refuse_table(path: Path) -> None:
    """Refuse a table where a device file is wanted. Raises DeviceError, which names the device of the table."""
    with path.open("rb") as file:
        if file.read(8) != b"\x89HDF\r\n\x1a\n":
            return
    from engine.device import DeviceError
    from engine.table import Table

    with Table.open(path) as table:
        name = table.device.name
    raise DeviceError(f"{path}: is a table of {name}; give the device file that it was built from, or a shipped name")


def built_paths(device: "Device", device_file: Path) -> tuple[Path, Path]:
    """Where `tactable build` puts the table of a device file: here, or beside the file."""
    return Path(f"{device.name}.nc"), device_file.with_name(f"{device.name}.nc")


def find_table(path: Path) -> Path:
    """A table, or the one that was built of a device file. Raises TableError for a device file without one."""
    if path.suffix != ".toml" or not path.is_file():
        return path
    from engine.table import Table, TableError

    device, problem = find_device(str(path)), ""
    for built in built_paths(device, path):
        if built.is_file():
            try:
                Table.open(built, device=device, verify=False).close()
            except TableError as error:
                problem = f" ({error})"
            else:
                return built
    raise TableError(f"{path}: no table of this device file lies here or beside it{problem}: tactable build {path}")


def cache_folder() -> Path:
    """Folder of files that can be remade, such as the demo's table."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "tactable"
