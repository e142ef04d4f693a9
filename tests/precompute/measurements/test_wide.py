"""Laws of tables as others write them: a form changes no reading, and what cannot be one is named."""

import io
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io

from precompute.measurements.csv import parse_csv
from precompute.measurements.mat import arrays_to_measurements, load_content
from precompute.measurements.measurement_file import read_measurements
from precompute.measurements.types import MeasurementError, Measurements
from tests.precompute.devices import shipped

DEVICE = shipped("reference-a")
HZ, PLACES_MM, NAMES = (90.0, 150.5, 210.0), (20.5, 140.0), ("left", "right")
VALUE = np.arange(1, 13).reshape(2, 2, 3) * np.exp(1j * np.arange(12)).reshape(2, 2, 3)
"""Readings (actuator, place, frequency), m/s^2."""
COLUMNS = [(name, mm, VALUE[i, p]) for i, name in enumerate(NAMES) for p, mm in enumerate(PLACES_MM)]


def wide(title: str, of: Callable[[complex], tuple[object, ...]], zero: str = "") -> str:
    """A wide table of the readings; title: headings of one place, of: their cells."""
    header = ",".join(title.format(name=name, mm=mm) for name, mm, _ in COLUMNS)
    rows = [",".join(str(cell) for *_, value in COLUMNS for cell in of(value[k])) for k in range(len(HZ))]
    return f"frequency (Hz),{header}\n{zero}" + "".join(f"{hz},{row}\n" for hz, row in zip(HZ, rows, strict=True))


def parts(value: complex) -> tuple[object, ...]:
    return value.real, value.imag


def polar(value: complex) -> tuple[object, ...]:
    return abs(value), np.degrees(np.angle(value))


PARTS = wide("{name} {mm} mm real (m/s^2),{name} {mm} mm imaginary (m/s^2)", parts)


def assert_read(found: Measurements) -> None:
    """Every reading at its place, for its actuator and its frequency."""
    assert len(found) == VALUE.size
    for i in range(len(NAMES)):
        for p, mm in enumerate(PLACES_MM):
            rows = np.isclose(found.position_m, 1e-3 * mm) & ~np.isnan(found.frequency_hz[:, i])
            order = np.argsort(found.frequency_hz[rows, i])
            assert found.frequency_hz[rows, i][order] == pytest.approx(np.array(HZ))
            assert found.acceleration[rows][order] == pytest.approx(VALUE[i, p])


@pytest.mark.parametrize(
    "text",
    [
        PARTS,
        wide("{mm} mm {name} Magnitude (m/s²),{name}_{mm}mm_Phase [deg]", polar),
        wide("FRF {name} at {mm} mm (m/s^2)", lambda value: (str(value).strip("()").replace("j", "i"),)),
        wide("{name} {mm} mm re (m/s^2),{name} {mm} mm im (m/s^2)", parts, "0" + ",0" * 8 + "\n"),
        PARTS.replace(" (Hz)", "")
        .replace(" (m/s^2)", "")
        .replace("\n", "\n" + ",".join(["Hz"] + 8 * ["[m/s²]"]) + "\n", 1),
        re.sub(r"(?m)^(?=f)", "amplitude left (%),", re.sub(r"(?m)^(?=\d)", "100,", PARTS)),
    ],
    ids=["parts", "polar", "complex", "with the line of 0 Hz", "units in a line", "amplitude of one actuator"],
)
def test_a_wide_table_holds_the_readings_of_its_places(text: str) -> None:
    assert_read(parse_csv(text, DEVICE, 0.0, "x.csv"))


@pytest.mark.parametrize("separator", [";", "\t"])
@pytest.mark.parametrize("first", ["", "sep={}\n", '"sep={}"\n'])
@pytest.mark.parametrize("comma", [".", ","])
def test_what_separates_cells_and_decimals_changes_no_reading(separator: str, first: str, comma: str) -> None:
    body = PARTS.replace(",", separator).replace(".", comma)
    quoted = "".join(f'"{cell}"{separator} ' for cell in body.split("\n")[0].split(separator))
    text = first.format(separator) + quoted + "\n" + body.split("\n", 1)[1]
    assert_read(parse_csv(text, DEVICE, 0.0, "x.csv"))


def test_files_of_other_programs_are_the_same_table(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_bytes(wide("{name} {mm} mm re (m/s²),{name} {mm} mm im (m/s²)", parts).encode("cp1252"))
    titles, *rows = (line.split(",") for line in PARTS.strip().split("\n"))
    end = "***End_of_Header***"
    channels = [cell for title in titles[1:] for cell in ("X_Value", title.removesuffix(" (m/s^2)"))]
    lvm = [
        *("LabVIEW Measurement", "Separator\tTab", "Decimal_Separator\t,", "X_Columns\tMulti", end, "", "Channels\t8"),
        *(
            "Y_Unit_Label" + "\tm/s^2\t" * 8,
            "X_Dimension" + "\tFrequency\t" * 8,
            end,
            "\t".join([*channels, "Comment"]),
        ),
        *("\t".join(each for cell in row[1:] for each in (row[0], cell)).replace(".", ",") for row in rows),
    ]
    (tmp_path / "x.lvm").write_text("\n".join(lvm), encoding="utf-8")
    content = {f"{name}_acceleration_m_s2": VALUE[i].T for i, name in enumerate(NAMES)}
    scipy.io.savemat(tmp_path / "x.mat", content | {"frequency_Hz": HZ, "position_mm": PLACES_MM})
    for name in ("x.csv", "x.lvm", "x.mat"):
        assert_read(read_here(tmp_path / name))


def read_here(path: Path) -> Measurements:
    """As `read_measurements`, which reads a MAT file in a process of its own."""
    if path.suffix == ".mat":
        return arrays_to_measurements(load_content(path), path, DEVICE, 0.0)
    return read_measurements(path, DEVICE)


@pytest.mark.parametrize(
    ("text", "named"),
    [
        (PARTS.replace("left 20.5 mm real", "left 20.5 mm reel"), "'reel'"),
        (PARTS.replace("left 20.5 mm real", "20.5 mm real"), "names no actuator"),
        (PARTS.replace("left 20.5 mm real", "left real"), "names no place"),
        (PARTS.replace("left 140.0", "left 20.5"), "is there twice"),
        (PARTS.replace("left 20.5", "left -20.5"), "-20.5 mm"),
        (PARTS.replace("real (m/s^2)", "real (kg)", 1), "'left 20.5 mm real (kg)'"),
        (PARTS.replace("left 20.5 mm imaginary", "left 99 mm imaginary"), "give all the same"),
        (PARTS + "250,1,,1,1,1,1,1,1\n", "row 5"),
        (PARTS + "250,1,x,1,1,1,1,1,1\n", "'x'"),
        (wide("{name} {mm} mm (m/s^2)", lambda value: (abs(value),)), "magnitude and phase"),
        (PARTS.replace("frequency (Hz)", "frequency centre (Hz)"), "names no actuator"),
    ],
)
def test_what_a_wide_table_does_not_say_is_named(text: str, named: str) -> None:
    with pytest.raises(MeasurementError) as caught:
        parse_csv(text, DEVICE, 0.0, "x.csv")
    assert named in str(caught.value) and str(caught.value).startswith("x.csv")


def saved(**arrays: object) -> bytes:
    file: Any = io.BytesIO()
    scipy.io.savemat(file, arrays)
    content: bytes = file.getvalue()
    return content


@pytest.mark.parametrize(
    ("name", "content", "remedy"),
    [
        ("x.mat", b"MATLAB 7.3 MAT-file", "-v7"),
        ("x.mat", b"MATLAB 5.0 MAT-file" + bytes(200), "-v7"),
        ("x.mat", saved(frequency_Hz=HZ, left=[1.0]), "expected"),
        ("x.mat", saved(a=1.0), "frequency_Hz"),
        ("x.mat", saved(a={"b": 1.0}), "as arrays"),
        ("x.lvm", b"LabVIEW Measurement\t\nno more", "segment"),
        (
            "x.lvm",
            b"LabVIEW Measurement\n***End_of_Header***\n***End_of_Header***\nX_Value\ta\n0\t1\n",
            "tactable measure",
        ),
        ("x.csv", b"a\0b", "UTF-8"),
        ("x.csv", b"\x81\xff", "UTF-8"),
    ],
)
def test_a_file_that_holds_no_table_is_named_with_the_remedy(
    tmp_path: Path, name: str, content: bytes, remedy: str
) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(MeasurementError) as caught:
        read_here(tmp_path / name)
    assert name in str(caught.value) and remedy in str(caught.value)


@pytest.mark.machine(stall_s=None)
def test_a_mat_file_is_read_by_a_process_of_its_own(tmp_path: Path) -> None:
    (tmp_path / "x.mat").write_bytes(saved(frequency_Hz=HZ, left_20p5mm_real_m_s2=HZ, left_20p5mm_imag_m_s2=HZ))
    assert read_measurements(tmp_path / "x.mat", DEVICE).acceleration == pytest.approx((1 + 1j) * np.array(HZ))
