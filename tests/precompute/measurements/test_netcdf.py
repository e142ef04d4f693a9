"""Laws of the NetCDF form: the same measurements as from CSV, in any unit; what is wrong is named."""

import os
import re
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray

from engine.device import Device
from precompute.measurements.measurement_file import read_measurements
from precompute.measurements.netcdf import measurements_of, read_netcdf
from precompute.measurements.netcdf_content import load_content, read_content
from precompute.measurements.types import MeasurementError, Measurements
from tests.precompute.devices import shipped
from tests.precompute.measured import NAN, read_bar
from tests.precompute.measurements.test_csv import assert_same

DEVICE = shipped("reference-a")
READ = read_bar(DEVICE, {}, ((150, 130), (140, NAN)), points=3)


def dataset(read: Measurements) -> xarray.Dataset:
    each, pair = ("measurement",), ("measurement", "actuator")
    return xarray.Dataset(
        {
            "position": (each, 1e3 * read.position_m, {"units": "mm"}),
            "frequency": (pair, read.frequency_hz, {"units": "Hz"}),
            "amplitude": (pair, np.abs(read.amplitude), {"units": "1"}),
            "sensor_mass": (each, 1e3 * read.sensor_mass_kg, {"units": "g"}),
            "peak_acceleration": (each, read.acceleration.real, {"units": "m s-2"}),
        },
        coords={"actuator": [actuator.name for actuator in DEVICE.actuators]},
        attrs={"source": "SIMULATED by a test"},
    )


def written(data: xarray.Dataset, folder: Path) -> Path:
    path = folder / "x.nc"
    data.to_netcdf(path, engine="h5netcdf")
    return path


def read_here(path: Path, device: Device = DEVICE) -> Measurements:
    """As `read_netcdf`, without the start of a process."""
    return measurements_of(load_content(path), path, device, 0.0)


def test_the_same_is_read_as_was_written(tmp_path: Path) -> None:
    assert_same(read_here(written(dataset(READ), tmp_path)), READ)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.assign_coords(actuator=["right", "left"]), "expected a coordinate with left, right"),
        (lambda d: d.drop_vars("actuator"), "expected a coordinate with left, right"),
        (lambda d: d.assign(weight=d.position), "weight: unknown variable; over 'measurement' are known position"),
        (lambda d: d.assign(position=d.position.drop_attrs()), "position: has no attribute 'units'"),
        (lambda d: d.assign(position=d.position.assign_attrs(units="kg")), "position: '1 kg' is a mass"),
        (lambda d: d.drop_vars("peak_acceleration"), "expected a column 'peak acceleration'"),
        (lambda d: d.assign(position=(("measurement",), ["a"] * 6, {"units": "mm"})), "position: could not convert"),
        (
            lambda d: d.assign(position=d.position.astype(complex).assign_attrs(units="mm")),
            "position: has complex values",
        ),
    ],
)
def test_what_is_wrong_is_named(change: object, message: str, tmp_path: Path) -> None:
    assert callable(change)
    with pytest.raises(MeasurementError) as caught:
        read_here(written(change(dataset(READ)), tmp_path))
    assert message in str(caught.value)


def _link(file: h5py.File, link: object) -> None:
    del file["sensor_mass"]
    file["sensor_mass"] = link


def _virtual(file: h5py.File, folder: Path) -> None:
    layout = h5py.VirtualLayout((6,), "f8")
    layout[:] = h5py.VirtualSource(str(folder / "secret.nc"), "position", (6,))
    file.create_virtual_dataset("finger_position", layout)


def _large(file: h5py.File, **rows: int) -> None:
    for name, size in rows.items():
        file.create_dataset(name, (size,), "f8", chunks=True)


def _outside(file: h5py.File, folder: Path) -> None:
    (folder / "secret").write_bytes(bytes(48))
    file.create_dataset("finger_position", (6,), "f8", external=[(str(folder / "secret"), 0, 48)])


def _not_a_number(file: h5py.File, _: Path) -> None:
    file["peak_acceleration"][4] = np.nan


STRUCTURES: dict[str, tuple[Callable[[h5py.File, Path], None], str]] = {
    # To a pipe a link would wait for ever; to another file it would read what the user did not name.
    "a link to a pipe": (lambda file, _: _link(file, h5py.ExternalLink("pipe", "/x")), "sensor_mass: is a link"),
    "a soft link": (lambda file, _: _link(file, h5py.SoftLink("/frequency")), "sensor_mass: is a link"),
    "a virtual array": (_virtual, "finger_position: its values are in another file"),
    "values elsewhere": (_outside, "finger_position: its values are in another file"),
    "one that fills the memory": (lambda file, _: _large(file, finger_position=10**12), "at most 67 MB"),
    "two that do": (lambda file, _: _large(file, finger_position=5 * 10**6, finger_phase=5 * 10**6), "at most 67 MB"),
    "no number": (_not_a_number, "measurement 4: peak_acceleration: nan"),
}


@pytest.mark.parametrize("case", STRUCTURES)
def test_a_file_of_another_structure_is_refused_by_name(case: str, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    path, (change, says) = written(dataset(READ), tmp_path), STRUCTURES[case]
    with h5py.File(path, "a") as file:
        change(file, tmp_path)
    assert path.stat().st_size < 1e6
    with pytest.raises(MeasurementError) as caught:
        read_here(path)
    assert says in str(caught.value)


@pytest.mark.machine(stall_s=None)
def test_the_child_that_reads_finds_the_same_refuses_in_the_same_words_and_ends_where_hdf5_does_not(
    tmp_path: Path,
) -> None:
    assert_same(read_measurements(written(dataset(READ), tmp_path), DEVICE), READ)
    (tmp_path / "x.nc").write_text("no NetCDF")
    with pytest.raises(MeasurementError, match="not a NetCDF-4 file") as here:
        load_content(tmp_path / "x.nc")
    with pytest.raises(MeasurementError, match=re.escape(str(here.value))):
        read_netcdf(tmp_path / "x.nc", DEVICE, 0.0)
    with pytest.raises(MeasurementError, match="is not a plain file"):
        read_netcdf(tmp_path, DEVICE, 0.0)
    # A case of the fuzzer (netcdf, seed 7, number 720), on which HDF5 1.14 does not end: 2 s of processor time.
    path = Path(__file__).with_name("endless.bin")
    with pytest.raises(MeasurementError, match=f"^{re.escape(str(path))}: "):
        read_content(path, limit_s=2)
