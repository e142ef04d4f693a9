"""Command `new`: a device file for a bar or plate of one's own, in which whatever was not given is an estimate.

The file begins as `tables/new-bar.toml` or `tables/new-plate.toml`; what is given takes the places of estimates.
"""

import copy
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import tomlkit
import typer

from base.files import replace_file
from base.points import point_text, point_words, rows_of_squares
from engine.device import Device, DeviceError
from engine.device.quantity import read_quantity
from engine.device.threshold import DEFAULT as DEFAULT_THRESHOLD
from tactable.cli.console import say
from tactable.cli.options import OptionError, names_in, read_option, refuse_existing
from tactable.shipped import new_text

# Young's modulus, density and Poisson's ratio: handbook values at room temperature; alloys and batches differ by some
# per cent, plastics more. Loss factor about 200 Hz: orders of magnitude of the material alone (metals below 0.001 in L.
# Cremer and M. Heckl, Structure-Borne Sound, 1988); None: that of the published bar.
MATERIALS = {
    "aluminium": ("70 GPa", "2700 kg/m^3", "33 %", None),
    "steel": ("200 GPa", "7850 kg/m^3", "29 %", 0.001),
    "stainless-steel": ("193 GPa", "8000 kg/m^3", "29 %", 0.001),
    "titanium": ("110 GPa", "4500 kg/m^3", "34 %", 0.001),
    "brass": ("105 GPa", "8500 kg/m^3", "34 %", 0.001),
    "glass": ("72 GPa", "2500 kg/m^3", "23 %", 0.002),
    "acrylic": ("3.2 GPa", "1190 kg/m^3", "37 %", 0.06),
    "polycarbonate": ("2.35 GPa", "1200 kg/m^3", "37 %", 0.015),
    "fr4": ("22 GPa", "1850 kg/m^3", "14 %", 0.02),
}
_JOINTS = 0.02  # ESTIMATE of what joints and adhesive add to a loss factor; those of built metal structures are higher
_LOSS_AT_HZ = 200.0
# ESTIMATES of what is sold, by kind: docs/actuators.md says where they come from and how a data sheet replaces them.
KINDS: dict[str, dict[str, Any]] = {
    "electrostatic": {"stiffness": "18.9 kN/m", "damping": "0.045 N*s/m", "mass": "9.5 g", "full_scale": "0.52 um"},
    "piezo-stack": {"stiffness": "20 MN/m", "damping": "20 N*s/m", "mass": "5 g", "full_scale": "10 um"},
    "piezo-bender": {
        "moving_mass": "1 g", "stiffness": "1.58 kN/m", "damping": "0.063 N*s/m", "mass": "2 g", "full_scale": "0.3 N",
        "band": ["100 Hz", "300 Hz"],
    },
    "voice-coil": {"stiffness": "1 kN/m", "damping": "0.5 N*s/m", "mass": "5 g", "full_scale": "1 N"},
    "lra": {
        "moving_mass": "1.5 g", "stiffness": "1.81 kN/m", "damping": "0.11 N*s/m", "mass": "1 g", "full_scale": "35 mN",
        "band": ["120 Hz", "260 Hz"],
    },
    "exciter": {
        "moving_mass": "40 g", "stiffness": "15.8 kN/m", "damping": "8.4 N*s/m", "mass": "10 g", "full_scale": "3 N",
    },
}  # fmt: skip
_LONGEST_NAME = 64  # it is in titles, names of files and errors


def new(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Name of the device, and of its file NAME.toml.")],
    length: Annotated[str, typer.Option(help="Length of the bar or plate, such as 300mm.")],
    thickness: Annotated[str, typer.Option(help="Its thickness, such as 1mm.")],
    actuators: Annotated[str, typer.Option(help='Their positions: 40mm,260mm or %; on a plate "30x25 mm,270x35 mm".')],
    width: Annotated[
        str | None, typer.Option(help="Width; needed for a plate, of a bar the estimate is 12.7 mm.")
    ] = None,
    material: Annotated[str | None, typer.Option(help=f"{', '.join(MATERIALS)}; estimate: aluminium.")] = None,
    kind: Annotated[
        str | None, typer.Option(help=f"Of actuators, for their estimates: {', '.join(KINDS)}; the first unless given.")
    ] = None,
    zones: Annotated[
        int | None, typer.Option(min=1, max=16, help="Number of equal zones; estimate: 5, on a plate 6.")
    ] = None,
    threshold: Annotated[
        str, typer.Option("--threshold", metavar="CURVE", help="Shipped threshold curve that levels are above.")
    ] = DEFAULT_THRESHOLD,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="The file; default NAME.toml here.")] = None,
) -> None:
    """Write a device file for your bar or plate; what is not given is an estimate.

    Data sheets take the places of estimates in the file (docs/devices.md). `tactable check` then says what follows from
    it, and `tactable calibrate` what measurements make of the estimates.
    """
    path = output or Path(f"{name}.toml")
    if path.suffix != ".toml":
        raise OptionError(f"-o {path}: a device file is TOML; name it {path.stem or name}.toml")
    refuse_existing(path, "another name, or edit the file")
    check_answer("name", name)
    surface = "plate" if len(point_words(actuators.split(",")[0])) > 1 else "bar"
    document: Any = tomlkit.parse(new_text(surface))
    document["name"], document["threshold"] = name, threshold
    if surface == "plate" and width is None:
        raise OptionError(f"--width: {actuators} are points of a plate; give its width, such as --width 180mm")
    for key, text in (("length", length), ("width", width), ("thickness", thickness)):
        if text is not None:
            _set(document[surface], key, _checked(f"--{key}", text, "m"))
    if material is not None:
        _take_material(document[surface], material)
    if kind is not None:
        _take_kind(document, kind)
    if zones is not None:
        _divide(document, surface, zones)
    _place(document, actuators)
    text = tomlkit.dumps(document)
    try:
        device = Device.parse(text, str(path))
    except DeviceError as error:
        raise OptionError(f"these values are no {surface}: {error}") from error
    with replace_file(path) as partial:
        partial.write_text(text, encoding="utf-8")
    size = f"{point_text(device.surface.corner_m)} long" if surface == "bar" else point_text(device.surface.corner_m)
    say(f"{path}: a {surface}, {size}, {len(device.actuators)} actuators, {len(device.zones)} zones")
    estimates = device.estimated_values
    say(f"{len(estimates)} values are ESTIMATES, which the file marks")
    say(f"next: tactable check {path}, which says which of them matter most")


def check_answer(option: str, text: str) -> None:
    """Check the text of one option, or the name. Raises OptionError, as `new` would."""
    match option:
        case "name":
            if not 0 < len(text) <= _LONGEST_NAME or not text.replace("-", "").replace("_", "").isalnum():
                raise OptionError(f"NAME {text!r}: expected letters, digits, - and _, such as my-bar")
        case "material":
            _known("--material", text, MATERIALS)
        case "actuators":
            for place in names_in(text):
                _position(place)
        case _:
            _checked(f"--{option}", text, "m")


def _known(option: str, name: str, values: Mapping[str, Any]) -> Any:
    if name not in values:
        raise OptionError(f"{option} {name!r}: expected one of {', '.join(values)}")
    return values[name]


def _take_material(table: Any, name: str) -> None:
    """Set Young's modulus, density and of a plate Poisson's ratio; the damping is an estimate.

    A loss factor is 2 pi f times the stiffness damping.
    """
    modulus, density, ratio, loss = _known("--material", name, MATERIALS)
    values = {"youngs_modulus": modulus, "density": density, "poissons_ratio": ratio}
    for key in values.keys() & table.keys():
        _set(table, key, values[key])
    if loss is not None:
        table["stiffness_damping"] = f"{(loss + _JOINTS) / (2 * math.pi * _LOSS_AT_HZ):.3g} s"


def _take_kind(document: Any, name: str) -> None:
    """Give the actuators what is usual of a kind, as estimates."""
    table, values = document["actuator"][0], _known("--kind", name, KINDS)
    table.update(values)
    if "moving_mass" in values:
        table["kind"] = "inertial"
        table["inferred"].append("moving_mass")
    document["sweep"]["start"], document["sweep"]["stop"] = table["band"]


def _set(table: Any, key: str, value: Any) -> None:
    """Set a value, which is no estimate any more."""
    table[key] = value
    if key in table["inferred"]:
        table["inferred"].remove(key)
    if not table["inferred"]:
        del table["inferred"]


def _divide(document: Any, surface: str, zones: int) -> None:
    """Divide the surface into equal zones, those of a plate as square as they can be."""
    if surface == "bar":
        _set(document["zones"], "count", zones)
        return
    length_m, width_m = (read_quantity(document["plate"][key], "m") for key in ("length", "width"))
    rows = rows_of_squares(zones, complex(length_m, width_m))
    _set(document["zones"], "rows", rows)
    _set(document["zones"], "columns", zones // rows)


def _place(document: Any, positions: str) -> None:
    """Put an actuator like the first one at each position."""
    places = names_in(positions)
    if not places:
        raise OptionError("--actuators names no position; give at least one, such as --actuators 40mm,260mm")
    placed = tomlkit.aot()
    for number, place in enumerate(places, 1):
        table = copy.deepcopy(document["actuator"][0])
        table["name"], table["position"] = f"actuator-{number}", _position(place)
        placed.append(table)
    document["actuator"] = placed


def _checked(option: str, text: str, unit: str) -> str:
    """The text of a quantity, once it is one; a unit right behind the number gets its space."""
    read_option(option, text, unit)
    number = text.strip()
    end = next((at for at, letter in enumerate(number) if letter.isalpha() and letter not in "eE"), len(number))
    return f"{number[:end].rstrip()} {number[end:]}".strip()


def _position(text: str) -> str | list[str]:
    """A position of an actuator: a length or a percentage; of a plate two of them."""
    words = point_words(text)
    return _length(text) if len(words) == 1 else [_length(word) for word in words]


def _length(text: str) -> str:
    if not text.endswith("%"):
        return _checked("--actuators", text, "m")
    try:
        float(text[:-1])
    except ValueError:
        raise OptionError(f"--actuators {text!r}: expected a length or a percentage, such as 40mm or 16%") from None
    return f"{text[:-1].strip()} %"
