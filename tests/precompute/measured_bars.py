"""The public measured bars beside the repository (../shared/measured), each as a file that this project reads.

They are not part of it. The README there names sources and licences; docs/theory.md says what they show.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyuff
import scipy.io

from base.arrays import Array, Complex
from engine.device import Device

FOLDER = Path(__file__).parents[3] / "shared" / "measured"
needs_bars = pytest.mark.skipif(not FOLDER.is_dir(), reason="no recordings: the public measured bars are absent")
FIRST_HZ = 20  # below it the beam's accelerances are of its rigid motion on what carried it
BEAM_M = (0.973, 0.922, 0.873)
CANTILEVER_HZ = np.array([6.62, 41.4, 117.5])
SOFT = """[[actuator]]
name = "{name}"
position = "{position}"
stiffness = "{stiffness}"
damping = "0 N*s/m"
mass = "0 g"
full_scale = "{full_scale}"
band = ["{start}", "{stop}"]
"""
TEXT = """name = "{name}"
[bar]
length = "{length}"
width = "{width}"
thickness = "{thickness}"
youngs_modulus = "{modulus}"
density = "7850 kg/m^3"
mass_damping = "1 1/s"
stiffness_damping = "1e-7 s"
{actuators}[zones]
count = 5
[finger]
mass = "0.1 g"
damping = "1 N*s/m"
stiffness = "1 kN/m"
[sweep]
start = "{start}"
stop = "{stop}"
step = "{step}"
amplitude_steps = 1
[limits]
ramp = "5 ms"
"""


def steel(
    name: str, size: tuple[str, str, str], places: tuple[str, ...], band: tuple[str, str, str], **other: str
) -> Device:
    """A steel bar on springs so soft, or so stiff, that it is free or clamped there; band: start, stop and step."""
    start, stop, step = band
    values = {"stiffness": "0.01 N/m", "full_scale": "100 m", "start": start, "stop": stop} | other
    mounts = zip(("one", "two"), places, strict=False)
    actuators = "".join(SOFT.format(name=name, position=place, **values) for name, place in mounts)
    length, width, thickness = size
    values |= {"length": length, "width": width, "thickness": thickness, "step": step, "modulus": "210 GPa"} | other
    return Device.parse(TEXT.format(**values | {"name": name, "actuators": actuators}), name)


def beam() -> Device:
    """The free beam: of no stated size, so of one that has its first mode, and about its level."""
    return steel("beam", ("1 m", "250 mm", "9.69 mm"), ("2.7 %",), ("20 Hz", "1 kHz", "20 Hz"))


def ruler() -> Device:
    """The ruler: of no stated size, so 300 mm with the thickness that has its first mode."""
    return steel("ruler", ("300 mm", "30 mm", "0.667 mm"), ("100 %",), ("30 Hz", "450 Hz", "2 Hz"))


def cantilever(held_mm: int = 20) -> Device:
    """The cantilever of stated size, held by two very stiff springs at the ends of a clamp behind its free length."""
    size = (f"{759 + held_mm} mm", "50.66 mm", "5.14 mm")
    ends, stiff = ("0 mm", f"{held_mm} mm"), {"stiffness": "1e9 N/m", "full_scale": "1 um", "modulus": "200 GPa"}
    return steel("cantilever", size, ends, ("5 Hz", "200 Hz", "5 Hz"), **stiff)


def beam_responses() -> tuple[Array, Complex]:
    """Frequencies in Hz (line,), and accelerances (place, line) at BEAM_M."""
    lines = [(FOLDER / f"pyuff_beam_{k}.txt").read_text().split() for k in (1, 2, 3)]
    value = np.array([[complex(line) for line in each[FIRST_HZ:]] for each in lines])
    return np.arange(FIRST_HZ, FIRST_HZ + value.shape[1], dtype=np.float64), value


def beam_file(folder: Path) -> Path:
    """The beam's accelerances as a universal file per newton."""
    hz, values = beam_responses()
    x_m = [*BEAM_M, 0.027]
    zero, numbers = [0.0] * 4, [1, 2, 3, 4]
    kinds = {"def_cs": numbers, "disp_cs": numbers, "color": numbers}
    sets: list[dict[str, Any]] = [dict(pyuff.prepare_15(node_nums=numbers, x=x_m, y=zero, z=zero, **kinds))]
    names = {"rsp_ent_name": "beam", "ref_ent_name": "beam", "id1": "pyuff, data/meas_point_1 to 3"}
    axes = {"abscissa_spec_data_type": 18, "ordinate_spec_data_type": 12, "orddenom_spec_data_type": 13}
    units = {"ordinate_axis_units_lab": "m/s^2", "orddenom_axis_units_lab": "N"}
    for node, value in enumerate(values, 1):
        places = {"rsp_node": node, "rsp_dir": 3, "ref_node": 4, "ref_dir": 3}
        sets.append(dict(pyuff.prepare_58(binary=0, func_type=4, data=value, x=hz, **places, **names, **axes, **units)))
    path = folder / "beam.uff"
    pyuff.UFF(str(path)).write_sets(sets, "add")
    return path


def ruler_responses(low_hz: float = 25.0, high_hz: float = 600.0) -> tuple[Array, Array, Complex]:
    """Frequencies in Hz (line,), places in mm (place,) and responses (line, place), whose scale is not stated."""
    archive = np.load(FOLDER / "pydvma_ruler.npz")
    hz, value = archive["frequency_hz"].astype(np.float64), archive["response"].astype(np.complex128)
    within = (hz > low_hz) & (hz < high_hz)
    return hz[within], np.linspace(0, 300, value.shape[1]), value[within]


def ruler_mat(folder: Path) -> Path:
    """The ruler's responses as a MAT file, taken for m/s^2 per newton."""
    hz, place_mm, value = ruler_responses()
    path = folder / "ruler.mat"
    arrays = {"frequency_Hz": hz, "position_mm": place_mm, "one_accelerance_m_s2_N": value}
    scipy.io.savemat(str(path), arrays)
    return path


def ruler_csv(folder: Path) -> Path:
    """The same as a wide table in CSV, of complex cells."""
    hz, place_mm, value = ruler_responses()
    path = folder / "ruler.csv"
    titles = ["frequency (Hz)", *(f"one {at:.6f} mm accelerance (m/s^2/N)" for at in place_mm)]
    rows = [
        ",".join([repr(at), *(f"{z.real:.9g}{z.imag:+.9g}i" for z in row)])
        for at, row in zip(hz.tolist(), value, strict=True)
    ]
    path.write_text("\n".join([",".join(titles), *rows, ""]), encoding="utf-8")
    return path
