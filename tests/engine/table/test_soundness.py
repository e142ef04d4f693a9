"""Laws of an opened table that somebody changed and sealed again: refused by name, and no other file is touched."""

import math
import os
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from engine.table import Table
from engine.table.schema import SCHEMA
from tests.engine.made_table import changed, click_of, in_zones, replace_array, rows_of, write_table
from tests.engine.table.test_table import DEVICE, refusal

Change = Callable[[h5py.File, Path], object]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    clicks = [click_of(DEVICE, in_zones(DEVICE, [0])), click_of(DEVICE, in_zones(DEVICE, [1], [3]))]
    return write_table(
        tmp_path_factory.mktemp("sound") / "whole.nc", DEVICE, clicks, rows=rows_of(DEVICE, (20.0, math.inf))
    )


def test_a_resealed_table_that_was_not_changed_opens(whole: Path, tmp_path: Path) -> None:
    with Table.open(changed(whole, tmp_path / "same.nc", lambda _file: None)) as table, Table.open(whole) as before:
        assert table.best_rows == before.best_rows


def linked(link: Callable[[Path], object], name: str = "responses") -> Change:
    def change(file: h5py.File, folder: Path) -> None:
        if name in file:
            del file[name]
        file[name] = link(folder)

    return change


def _move_out(file: h5py.File, folder: Path) -> None:
    (folder / "secret.bin").write_bytes(bytes(64))
    del file["best_rows/drive_amplitude"]
    outside = [(str(folder / "secret.bin"), 0, h5py.h5f.UNLIMITED)]
    file["best_rows"].create_dataset("drive_amplitude", (2, 31, 2), "f8", external=outside)


def _make_virtual(file: h5py.File, folder: Path) -> None:
    layout = h5py.VirtualLayout((2, 2, 2), "f8")
    layout[...] = h5py.VirtualSource(str(folder / "other.h5"), "values", (2, 2, 2))
    del file["best_rows/drive_amplitude"]
    file["best_rows"].create_virtual_dataset("drive_amplitude", layout)


def _hide(file: h5py.File, _: Path) -> None:
    """NetCDF marks so what stands for a dimension alone, which has no values to check."""
    file["best_rows/drive_amplitude"][...] = math.inf
    name = b"This is a netCDF dimension but not a netCDF variable         2"
    file["best_rows/drive_amplitude"].attrs["NAME"] = np.bytes_(name)


def _rename(file: h5py.File, _: Path) -> None:
    file["best_rows/zone"][0] = "elsewhere"


STRUCTURES: dict[str, tuple[Change, str]] = {
    # A reader that followed the first to a pipe would wait for ever.
    "an external link": (linked(lambda folder: h5py.ExternalLink(str(folder / "pipe"), "/")), "responses: is a link"),
    "a soft link": (linked(lambda _: h5py.SoftLink("/best_rows"), "best_rows/again"), "is a link"),
    "a group in a group": (lambda file, _: file.copy("best_rows", "best_rows/again"), "a dataset"),
    "values in another file": (_move_out, "drive_amplitude: its values are in another file"),
    "a virtual dataset": (_make_virtual, "drive_amplitude: its values are in another file"),
    # HDF5 gives it no room until it is written.
    "a huge array": (lambda file, _: file["responses"].create_dataset("huge", (1 << 40,), "f8"), "more than the file"),
    "an array that says it is none": (_hide, "best_rows/drive_amplitude: is marked as a dimension"),
    "names of another device": (_rename, "best_rows/zone"),
}


@pytest.mark.parametrize("case", STRUCTURES)
def test_a_file_of_another_structure_is_refused_by_name(whole: Path, tmp_path: Path, case: str) -> None:
    os.mkfifo(tmp_path / "pipe")
    change, says = STRUCTURES[case]
    assert says in refusal(changed(whole, tmp_path / "x.nc", lambda file: change(file, tmp_path)))


@pytest.mark.parametrize(
    ("name", "values", "says"),
    [
        ("best_rows/drive_amplitude", np.ones((2, 31, 3)), "has shape"),
        ("best_rows/drive_amplitude", np.ones((2, 31, 2), dtype="S3"), "numbers or text"),
        ("best_rows/drive_amplitude", np.ones((2, 31, 2), dtype=np.int64), "real values"),
        ("best_rows/drive_amplitude", np.full((2, 31, 2), math.nan), "finite values"),
        ("best_rows/drive_amplitude", np.full((2, 31, 2), -0.1), "below 0"),
        ("best_rows/level", np.array([20.0, 20.0]), "rising levels"),
        ("best_rows/group", np.ones((2, 31)), "text values"),
        ("clicks/weight", np.ones((2, 3)), "whole values"),
        ("clicks/fraction_bits", np.array([0, 99]), "above 31"),
        ("clicks/basis_set", np.array([0, -1]), "below 0"),
        ("clicks/finger_place", np.array([[1, -1], [3, 99]]), "at one of the places"),
        ("clicks/finger_place", np.array([[-1, 1], [3, 7]]), "at least one finger"),
        ("clicks/finger_place", np.array([[1, -1], [3, 3]]), "rising places"),
        ("clicks/finger_felt", np.array([[1, 0], [1, 2]]), "above 1"),
        ("clicks/place", np.array([0.0, 0.1, 0.2]), "an even grid"),
        ("modes/along", np.linspace(0.0, 0.1, 9), "an even grid"),
        ("modes/across", np.array([1.0]), "an even grid"),
        ("modes/frequency", np.full(25, 100.0), "rising frequencies"),
        ("modes/frequency", np.linspace(1e-300, 1e300, 25), "below 0.001"),
        ("modes/threshold", np.full(25, 1e-300), "below 1e-09"),
        ("modes/drive", np.zeros((2, 2, 25, 2), dtype=np.float32), "no actuator moves any function"),
        ("modes/shape", np.ones((1, 9, 1), dtype=np.float32), "function 2"),
        ("modes/natural_frequency", np.array([100.0]), "moves without end"),
        ("modes/damper", np.ones(3), "actuator 2"),
        ("clicks/weight", 32768, "above 32767"),
        ("clicks/set_samples", 1, "below 2"),
        ("clicks/set_samples", 10_000, "more than the functions of the basis have"),
        ("clicks/function_actuator", 2, "an actuator that the device does not have"),
        ("clicks/sample", 0.0, "two rising times"),
        ("best_rows/achieved", 3, "above 1"),
    ],
)
def test_a_wrong_array_is_refused_by_name(whole: Path, tmp_path: Path, name: str, values: object, says: str) -> None:
    def put(file: h5py.File) -> None:
        filled = isinstance(values, int | float)
        replace_array(file, name, np.full_like(file[name], values, dtype=type(values)) if filled else values)

    found = refusal(changed(whole, tmp_path / "changed.nc", put))
    assert name in found and says in found


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("created", np.ones(3)),
        ("format_revision", "four"),
        ("mesh_elements", 50.5),
        ("click_pitch_m", np.zeros(1)),
        ("click_tolerance_m", "1 mm"),
    ],
)
def test_an_attribute_of_another_kind_is_refused(whole: Path, tmp_path: Path, name: str, value: object) -> None:
    found = refusal(changed(whole, tmp_path / "attribute.nc", lambda file: file.attrs.update({name: value})))
    assert "corrupted" in found


def test_a_table_of_real_arrays_is_declared_whole(whole: Path) -> None:
    with h5py.File(whole) as file:
        names = {f"{group}/{name}" for group in file for name in file[group] if "crc32" in file[group][name].attrs}
    assert names == {name for name in names if name.split("/")[1] in SCHEMA[name.split("/")[0]]}
