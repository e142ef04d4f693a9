"""Command `new`: a device file for a bar of one's own, in which whatever was not given is marked as an estimate."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from base.files import replace_file
from engine.device import Device, DeviceError
from engine.device.quantity import read_quantity
from engine.device.threshold import DEFAULT as DEFAULT_THRESHOLD
from tactable.cli.console import say
from tactable.cli.options import OptionError, names_in, read_option


@dataclass(frozen=True)
class Material:
    """Young's modulus and density as device files have them."""

    youngs_modulus: str
    density: str


# Usual handbook values at room temperature; alloys and batches differ by some per cent.
MATERIALS = {
    "aluminium": Material("70 GPa", "2700 kg/m^3"),
    "steel": Material("200 GPa", "7850 kg/m^3"),
    "stainless-steel": Material("193 GPa", "8000 kg/m^3"),
    "titanium": Material("110 GPa", "4500 kg/m^3"),
    "brass": Material("105 GPa", "8500 kg/m^3"),
    "glass": Material("72 GPa", "2500 kg/m^3"),
    "acrylic": Material("3.2 GPa", "1190 kg/m^3"),
    "polycarbonate": Material("2.35 GPa", "1200 kg/m^3"),
    "fr4": Material("22 GPa", "1850 kg/m^3"),
}

_ACTUATOR_UNITS = {"stiffness": "N/m", "damping": "N*s/m", "mass": "kg", "full_scale": "m"}
_LONGEST_NAME = 64  # it is in titles, names of files and errors
_OPTIONAL_KEYS = "# optional, where known: transfer, and below [actuator.electrodes] (docs/devices.md)"


def new(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Name of the bar, and of its file NAME.toml.")],
    length: Annotated[str, typer.Option(help="Length of the bar, such as 300mm.")],
    thickness: Annotated[str, typer.Option(help="Thickness of the bar, such as 1mm.")],
    actuators: Annotated[str, typer.Option(help="Positions of the actuators, from the bar's start: 40mm,260mm or %.")],
    width: Annotated[str | None, typer.Option(help="Width of the bar; estimate: 12.7 mm.")] = None,
    material: Annotated[
        str | None, typer.Option(help=f"Of the bar: {', '.join(MATERIALS)}; estimate: aluminium.")
    ] = None,
    youngs_modulus: Annotated[str | None, typer.Option(help="In place of the material's, such as 69GPa.")] = None,
    density: Annotated[str | None, typer.Option(help="In place of the material's, such as 2710kg/m^3.")] = None,
    stiffness: Annotated[str | None, typer.Option(help="Of each actuator's mount; estimate: 18.9 kN/m.")] = None,
    damping: Annotated[str | None, typer.Option(help="Of each actuator's mount; estimate: 0.045 N*s/m.")] = None,
    mass: Annotated[str | None, typer.Option(help="Of each actuator's moving part; estimate: 9.5 g.")] = None,
    full_scale: Annotated[str | None, typer.Option(help="Base displacement at full scale; estimate: 0.52 um.")] = None,
    band: Annotated[str | None, typer.Option(help="In which actuators may be driven; estimate: 60Hz,300Hz.")] = None,
    zones: Annotated[int | None, typer.Option(min=1, max=16, help="Number of equal zones; estimate: 5.")] = None,
    threshold: Annotated[
        str, typer.Option("--threshold", metavar="CURVE", help="Shipped threshold curve that levels are above.")
    ] = DEFAULT_THRESHOLD,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="The file; default NAME.toml here.")] = None,
) -> None:
    """Write a device file for your bar; what you do not give is marked as an estimate.

    `tactable check` then says what follows from it, and `tactable calibrate` what measurements make of the estimates.
    """
    path = output or Path(f"{name}.toml")
    if path.suffix != ".toml":
        raise OptionError(f"-o {path}: a device file is TOML; name it {path.stem or name}.toml")
    if path.exists() or path.is_symlink():
        raise OptionError(f"{path}: exists already and is not overwritten; choose another name, or edit the file")
    given = {"stiffness": stiffness, "damping": damping, "mass": mass, "full_scale": full_scale}
    edges = _edges(band or "60Hz,300Hz")
    parts = [
        _head(name, threshold),
        _bar(length, width, thickness, material, youngs_modulus, density),
        *_actuators(actuators, given, band is None, edges),
        _rest(zones, edges),
    ]
    text = "\n".join(parts)
    try:
        device = Device.parse(text, str(path))
    except DeviceError as error:
        raise OptionError(f"these values are no bar: {error}") from error
    with replace_file(path) as partial:
        partial.write_text(text, encoding="utf-8")
    say(f"{path}: {len(device.actuators)} actuators, {len(device.zones)} zones")
    estimates = device.estimated_values
    say(f"{len(estimates)} values are ESTIMATES: {', '.join(estimates)}")
    say(f"next: tactable check {path}")


def _head(name: str, threshold: str) -> str:
    if not 0 < len(name) <= _LONGEST_NAME or not name.replace("-", "").replace("_", "").isalnum():
        raise OptionError(f"NAME {name!r}: expected letters, digits, - and _, such as my-bar")
    head = f'name = "{name}"\ndescription = "Bar described by `tactable new`"\n'
    return f"{head}threshold = {json.dumps(threshold)} # the curve that levels are above; or the path of a file\n"


def _bar(
    length: str,
    width: str | None,
    thickness: str,
    material: str | None,
    youngs_modulus: str | None,
    density: str | None,
) -> str:
    if material is not None and material not in MATERIALS:
        raise OptionError(
            f"--material {material!r}: expected one of {', '.join(MATERIALS)}; or give modulus and density"
        )
    known = MATERIALS[material or "aluminium"]
    inferred = [] if width else ["width"]
    inferred += [] if material or youngs_modulus else ["youngs_modulus"]
    inferred += [] if material or density else ["density"]
    lines = [
        "[bar]",
        f'length = "{_checked("--length", length, "m")}"',
        f'width = "{_checked("--width", width or "12.7 mm", "m")}"',
        f'thickness = "{_checked("--thickness", thickness, "m")}"',
        f'youngs_modulus = "{_checked("--youngs-modulus", youngs_modulus or known.youngs_modulus, "Pa")}"',
        f'density = "{_checked("--density", density or known.density, "kg/m^3")}"',
        'mass_damping = "1.008e-5 1/s"      # sigma in C = C_A + sigma M + eta K',
        'stiffness_damping = "5.00456e-5 s" # eta',
        f"inferred = {_list([*inferred, 'mass_damping', 'stiffness_damping'])}",
        "",
    ]
    return "\n".join(lines)


def _edges(band: str) -> list[str]:
    edges = names_in(band)
    if len(edges) != 2:
        raise OptionError(f"--band {band!r}: expected two frequencies, such as --band 60Hz,300Hz")
    low, high = (_checked("--band", edge, "Hz") for edge in edges)
    if read_quantity(low, "Hz") >= read_quantity(high, "Hz"):
        raise OptionError(f"--band {band!r}: expected the lower frequency first, such as --band 60Hz,300Hz")
    return [low, high]


def _actuators(positions: str, given: dict[str, str | None], is_band_inferred: bool, edges: list[str]) -> list[str]:
    places = names_in(positions)
    if not places:
        raise OptionError("--actuators names no position; give at least one, such as --actuators 40mm,260mm")
    values = {"stiffness": "18.9 kN/m", "damping": "0.045 N*s/m", "mass": "9.5 g", "full_scale": "0.52 um"}
    inferred = [key for key in values if given[key] is None] + ["band"] * is_band_inferred
    shared = [
        f'{key} = "{_checked("--" + key.replace("_", "-"), given[key] or estimate, _ACTUATOR_UNITS[key])}"'
        for key, estimate in values.items()
    ]
    shared.append(f"band = {_list(edges)}")
    if inferred:
        shared.append(f"inferred = {_list(inferred)}")
    shared.append(_OPTIONAL_KEYS)
    return [
        "\n".join(["[[actuator]]", f'name = "actuator-{number}"', f'position = "{_position(place)}"', *shared, ""])
        for number, place in enumerate(places, 1)
    ]


def _rest(zones: int | None, edges: list[str]) -> str:
    lines = [
        "[zones]",
        f"count = {zones or 5} # equal; or [[zone]] tables with name, start, stop",
        'hysteresis = "2 mm"',
        f"inferred = {_list([*([] if zones else ['count']), 'hysteresis'])}",
        "",
        "[finger] # grounded mass-damper-spring, normal direction; 0.3 to 3 times",
        'mass = "0.1 g"',
        'damping = "1 N*s/m"',
        'stiffness = "1 kN/m"',
        "spread = 3.0",
        'inferred = ["mass", "damping", "stiffness", "spread"]',
        "",
        "[sweep]",
        f'start = "{edges[0]}"',
        f'stop = "{edges[1]}"',
        'step = "1 Hz"',
        "amplitude_steps = 5",
        "phase_steps = 36",
        "",
        "[feel] # dB above the threshold curve; full scale is always there too",
        'levels = ["10 dB", "20 dB", "30 dB"]',
        "",
        "[limits]",
        'amplitude = "100 %"',
        'ramp = "5 ms" # silence to full scale',
        'lease = "40 ms"',
        "",
    ]
    return "\n".join(lines)


def _checked(option: str, text: str, unit: str) -> str:
    """The text of a quantity, once it is one; a unit right behind the number gets its space."""
    read_option(option, text, unit)
    number = text.strip()
    end = next((at for at, letter in enumerate(number) if letter.isalpha() and letter not in "eE"), len(number))
    return f"{number[:end].rstrip()} {number[end:]}".strip()


def _position(text: str) -> str:
    if not text.endswith("%"):
        return _checked("--actuators", text, "m")
    try:
        float(text[:-1])
    except ValueError:
        raise OptionError(f"--actuators {text!r}: expected a length or a percentage, such as 40mm or 16%") from None
    return f"{text[:-1].strip()} %"


def _list(texts: list[str]) -> str:
    return "[" + ", ".join(f'"{text}"' for text in texts) + "]"
