"""Tables changed by somebody who seals them again, as an attacker would: flipped bits, other arrays, links."""

from collections.abc import Callable
from pathlib import Path

import h5py

from engine.table.netcdf_file import _SEAL, _append_seal, _read_seal


def reseal(path: Path) -> Path:
    """Seal the file as it is now."""
    if _read_seal(path) is not None:
        path.write_bytes(path.read_bytes()[: -_SEAL.size])
    _append_seal(path)
    return path


def changed(whole: Path, target: Path, change: Callable[[h5py.File], object]) -> Path:
    """A sealed copy of a table that `change` was applied to."""
    target.write_bytes(whole.read_bytes())
    with h5py.File(target, "a") as file:
        change(file)
    return reseal(target)


def replace_array(file: h5py.File, name: str, values: object) -> None:
    """Put other values, of any kind and shape, in the place of an array; its labels stay."""
    labels = dict(file[name].attrs)
    del file[name]
    file[name] = values
    for key in ("units", "long_name", "crc32"):
        file[name].attrs[key] = labels[key]
