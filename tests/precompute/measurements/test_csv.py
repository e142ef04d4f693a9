"""Laws of tables, plain and wide: what is written is read again, units are heeded, what is wrong is named."""

import io
import re
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
from hypothesis import given
from hypothesis import strategies as st

from base.arrays import Complex
from precompute.measurements.csv import parse_csv, write_csv
from precompute.measurements.mat import arrays_to_measurements, load_content
from precompute.measurements.measurement_file import read_measurements
from precompute.measurements.sheet import MOST_ROWS, example_csv
from precompute.measurements.types import Kind, MeasurementError, Measurements
from tests.precompute.devices import shipped

DEVICE = shipped("reference-a")
PER_NEWTON = "position (mm),frequency left (Hz),receptance magnitude (m/N),receptance phase (deg)"
HEADER = "position (mm),frequency left (Hz),frequency right (Hz),peak acceleration (m/s^2)"


def assert_same(found: Measurements, expected: Measurements) -> None:
    assert (found.kind, found.is_simulated) == (expected.kind, expected.is_simulated)
    for field in fields(Measurements):
        value = getattr(expected, field.name)
        if isinstance(value, np.ndarray):
            close = 1e-5 if field.name == "acceleration" else 1e-9
            np.testing.assert_allclose(getattr(found, field.name), value, rtol=close, atol=1e-15, err_msg=field.name)


@st.composite
def measurements(draw: Any) -> Measurements:
    rows, seed = draw(st.integers(1, 6)), draw(st.integers(0, 2**32 - 1))
    random = np.random.default_rng(seed)
    kind = draw(st.sampled_from(Kind))
    frequency_hz = random.uniform(60, 300, (rows, 2))
    if kind is Kind.RESPONSE:
        frequency_hz[:, 1] = frequency_hz[:, 0]
    phase = random.uniform(-3, 3, (rows, 2)) if draw(st.booleans()) else np.zeros((rows, 2))
    turned: Complex = np.exp(1j * phase)
    amplitude = random.uniform(0.01, 1.0, (rows, 2)) * turned
    still = random.integers(0, 3, rows)  # 0: none, 1: left, 2: right
    for i in (0, 1):
        amplitude[still == i + 1, i] = 0
    reading = random.uniform(0.01, 30, rows) * np.exp(1j * random.uniform(-3, 3, rows))
    finger_m = np.where(random.random(rows) < 0.5, random.uniform(0, 0.279, rows), np.nan)
    return Measurements(
        kind=kind,
        position_m=random.uniform(0, 0.279, rows),
        frequency_hz=np.where(amplitude == 0, np.nan, frequency_hz),
        amplitude=amplitude,
        sensor_mass_kg=random.uniform(0, 5e-3, rows),
        finger_m=finger_m if draw(st.booleans()) else np.full(rows, np.nan),
        acceleration=np.abs(reading).astype(complex) if kind is Kind.PEAK else reading,
        is_simulated=draw(st.booleans()),
    )


@given(measurements())
def test_what_is_written_is_read(written: Measurements) -> None:
    assert_same(parse_csv(write_csv(written, DEVICE, "made by a test"), DEVICE, 0.0, "x.csv"), written)


def test_units_are_heeded_absent_columns_have_their_meaning_and_a_byte_order_mark_has_none() -> None:
    text = (
        "\ufeff# a note\n\nposition (%),frequency left (Hz),amplitude left (1),phase left (deg),frequency right (Hz),"
        "peak acceleration (g_0)\n50,150,0.5,90,,2\n"
    )
    found = parse_csv(text, DEVICE, 1.5e-3, "x.csv")
    assert found.position_m[0] == pytest.approx(DEVICE.bar.length_m / 2)
    assert found.amplitude[0] == pytest.approx(np.array([0.5j, 0]))
    assert found.acceleration[0] == pytest.approx(2 * 9.80665)
    assert found.sensor_mass_kg[0] == 1.5e-3
    assert np.isnan(found.finger_m[0]) and not found.is_simulated


W = 300 * np.pi


@pytest.mark.parametrize(
    ("header", "expected"),
    [
        ("acceleration real (m/s^2/N),acceleration imaginary (m/s²/N)", 2 + 3j),
        ("accelerance real ((m/s^2)/N),accelerance imaginary (m/s^2)/N", 2 + 3j),
        ("acceleration magnitude (g/kN),acceleration phase (rad)", 2 * 9.80665e-3 * np.exp(3j)),
        ("acceleration real (m/(N·s²)),acceleration imaginary (1/kg)", 2 + 3j),
        ("mobility real (m/s/N),mobility imaginary ((mm/s)/mN)", 1j * W * (2 + 3j)),
        ("acceleration real ((m/s)/N),velocity imaginary (m s-1 N-1)", 1j * W * (2 + 3j)),
        ("receptance real (µm/N),displacement imaginary (µm/N)", -(W**2) * 1e-6 * (2 + 3j)),
        ("displacement magnitude (in/lbf),displacement phase (rad)", -(W**2) * 2 * 0.0254 / 4.4482216 * np.exp(3j)),
        ("mobility magnitude (M/(S*LBF)),mobility phase (rad)", 1j * W * 2 / 4.4482216 * np.exp(3j)),
        ("mobility real (m/Ns),acceleration imaginary (m/(Ns))", 1j * W * (2 + 3j)),
        ("accelerance real (m/Ns²),accelerance imaginary (m/s**2/N)", 2 + 3j),
        ("velocity real (m/s),velocity imaginary (m/s)", 1j * W * (2 + 3j)),
    ],
)
def test_responses_are_accelerations_whatever_their_unit(header: str, expected: complex) -> None:
    text = f"position (mm),frequency right (Hz),{header}\n100,150,2,3\n"
    found = parse_csv(text, DEVICE, 0.0, "x.csv")
    assert found.acceleration == pytest.approx([expected])
    assert found.kind is Kind.RESPONSE and found.amplitude.tolist() == [[0, 1]]
    if "velocity real" in header:
        assert found.force_m is None
    else:
        assert found.force_m == pytest.approx([DEVICE.actuators[1].position_m])


def test_a_force_may_be_anywhere() -> None:
    header = "position (mm),force position (%),frequency (Hz),receptance magnitude (m/N),receptance phase (deg)"
    found = parse_csv(f"{header}\n100,50,150,1,0\n100,90,150,1,0\n", DEVICE, 0.0, "x.csv")
    assert found.force_m == pytest.approx(np.array([0.5, 0.9]) * DEVICE.bar.length_m)
    assert found.drive_of_row.tolist() == [0, 1] and found.drive_text(0) == "150 Hz, 1 N at 139.7 mm"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "x.csv: is empty"),
        (PER_NEWTON + ",amplitude left (%)\n1,150,2,0,50\n", "a response per newton has one force in each row"),
        (PER_NEWTON + ",frequency right (Hz)\n1,150,2,0,150\n", "a response per newton has one force in each row"),
        (HEADER + ",force position (mm)\n1,150,130,2,50\n", "'force position': belongs to responses per newton"),
        (PER_NEWTON.replace("frequency left", "frequency") + "\n1,150,2,0\n", "'frequency (Hz)' with 'force position"),
        (PER_NEWTON + ",receptance imaginary (m/N)\n1,150,2,0,3\n", "expected a column 'peak acceleration', or the"),
        (PER_NEWTON.replace("m/N", "N/m") + "\n1,150,2,0\n", "is no unit of a response"),
        (PER_NEWTON.replace("m/N", "m/s") + "\n1,150,2,0\n", "'m/s' is the unit of velocity; expected m/N"),
        (HEADER + "\n", "has no measurement"),
        (HEADER + "\n1,150,130,2\n1,150,130,two\n", "row 3, column 'peak acceleration (m/s^2)': 'two'"),
        (HEADER + '\n"1,5",150,130,2\n', "row 2, column 'position (mm)': '1,5': expected a finite number"),
        (HEADER + "\nnan,150,130,2\n", "row 2, column 'position (mm)': 'nan'"),
        (HEADER + "\n1,150,130\n", "row 2: has 3 cells, the header 4"),
        (HEADER + '\n1,150,"130,2\n1,150,130,2\n', "row 2: is no row of numbers (unexpected end of data); close its"),
        (HEADER + "\n\n400,150,130,2\n", "row 3: position: 400 mm: expected 0 to 279.4 mm"),
        (HEADER.replace(" (mm)", "") + "\n1,150,130,2\n", "column 1: 'position': has no unit"),
        (HEADER.replace("(mm)", "(kg)") + "\n1,150,130,2\n", "column 1: 'position (kg)': '1 kg' is a mass"),
        (HEADER.replace("position", "postion") + "\n1,1,1,2\n", "did you mean 'position'?"),
        (HEADER.replace("right", "left") + "\n1,1,1,2\n", "column 3: 'frequency left (Hz)': is there twice"),
        (HEADER.replace("position", "sensor mass").replace("mm", "g") + "\n1,1,1,2\n", "has no column 'position'"),
        ("position (mm),frequency left (Hz)\n1,1\n", "expected a column 'peak acceleration', or the two"),
        (HEADER + ",amplitude right (%)\n1,150,130,2,\n", "row 2: amplitude right: is empty beside a frequency"),
        (HEADER + ",phase left (Hz)\n1,1,1,2,3\n", "'Hz' is not an angle"),
        (HEADER.replace(",", ";") + "\n1,5;150;130;2.1\n", "row 2: '2.1': has a point, other cells a comma"),
        ("position (mm),150 Hz,200 Hz\n1,2,3\n", "is a wide table: expected one column of the frequencies"),
        ("#time,accel_x,accel_y\n123.5,10.1,-20\n123.6,11.1,-21\n", "is a time series of Klipper, in mm/s^2"),
        ("freq,psd_x,psd_y,psd_xyz\n1,2,3,4\n", "holds power spectral densities of Klipper"),
        ("time (s),a (m/s^2)\n0,0.1\n1e-4,0.2\n", "is a time series: its first column is 'time (s)'"),
        (HEADER + "\nnot a number" * (MOST_ROWS + 1), f"x.csv: has {MOST_ROWS + 1} rows; expected at most {MOST_ROWS}"),
        (f"{HEADER}\n10,150,130,1\n{'1' * 200_000},150,130,1\n", "x.csv: row 3: is no row of numbers (field larger"),
        *(
            (f'{HEADER}\n10,150,130,1\n10,150,130,"1{rest}\n10,150,130,1\n', "close its quotation marks")
            for rest in ("", '"5')
        ),
        ("1,150,130,2\n2,150,130,2\n", "has no header: its first line is '1,150,130,2'"),
    ],
    ids=lambda value: repr(value)[:40],
)
def test_what_is_wrong_is_named_by_row_and_column(text: str, message: str) -> None:
    with pytest.raises(MeasurementError) as caught:
        parse_csv(text, DEVICE, 0.0, "x.csv")
    assert message in str(caught.value)


@pytest.mark.parametrize("name", ["reference-a", "reference-t"])
def test_the_example_of_the_right_form_can_be_read(name: str) -> None:
    device = shipped(name)
    header, row = (part.strip("'") for part in example_csv(device).split(", then rows such as "))
    assert len(parse_csv(f"{header}\n{row}\n", device, 0.0, "x.csv")) == 1


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
