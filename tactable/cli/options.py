"""Options that several commands share, and readers of their texts: zones, levels, quantities, drives, parameters."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer
from typer import Argument, Option

from base.errors import TactableError

if TYPE_CHECKING:
    from engine.device import Device
    from engine.effects.rules import Drives, Effects
    from engine.touch import Placement
    from precompute.measurements.parameters import Bounds

DEVICE_HELP = "A device file, or the name of a shipped device."
DeviceArgument = Annotated[str, Argument(metavar="DEVICE", help=DEVICE_HELP)]
DeviceOption = Annotated[str, Option("--device", help=DEVICE_HELP)]
TableArgument = Annotated[Path, Argument(metavar="TABLE", help="A built table.")]
OptionalTable = Annotated[Path | None, Argument(metavar="TABLE", help="A built table; default: that of the demo.")]
AsJson = Annotated[bool, Option("--json", help="Print JSON for machines.")]
FeltFingers = Annotated[
    str, Option("--felt", help="Fingers that feel it: positions, or zones for their middles, as 35mm,III.")
]
QuietFingers = Annotated[str, Option("--quiet", help="Fingers that must not feel: positions or zones.")]
Level = Annotated[str, Option("--level", help="Wanted level, dB above the detection threshold, or full.")]
ThresholdCurve = Annotated[
    str | None,
    Option("--threshold", metavar="CURVE", help="Threshold curve in place of the device's: shipped, or a TOML file."),
]
PressedThreshold = Annotated[
    str | None,
    Option("--threshold", metavar="CURVE", help="Threshold curve in place of the device's; 'CURVE, 8 N' pressed so."),
]
PictureOutputs = Annotated[
    list[Path] | None,
    Option("-o", "--output", help="The picture, .png, .svg or .pdf; its data, .csv; or once for each of them."),
]
RulesPath = Annotated[Path | None, Option("--rules", help="Rule file; default: a click at 20 dB for every touch.")]
DrivesOf = Annotated[
    str | None,
    Option("--drives", metavar="POSITIONS|ZONES", help="Drives solved for positions, or rows of the sweep for zones."),
]
ControlSocket = Annotated[
    Path | None, Option(help="The Unix socket of --control; default: tactable-control.sock in $XDG_RUNTIME_DIR.")
]
ControlPort = Annotated[
    int | None, Option(min=0, max=65_535, help="With --control also a WebSocket on this loopback port; 0: any.")
]
ControlOsc = Annotated[
    int | None, Option(min=0, max=65_535, help="With --control also Open Sound Control on this loopback port; 0: any.")
]
SensorMass = Annotated[str, Option("--sensor-mass", help="Mass of the accelerometer if the file states none, as 2 g.")]
ClicksUpTo = Annotated[
    int | None,
    Option(min=0, max=2, help="Most fingers that get clicks ahead, by default 2; more are solved as they come."),
]
Pitch = Annotated[
    str | None,
    Option(
        help="Clicks are made for fingers at places this far apart; finer takes longer. Default: 3 mm on a bar, 900 "
        "places on a plate."
    ),
]
Fit = Annotated[
    list[str] | None,
    Option("--fit", metavar="NAME[=LOW..HIGH]", help="Fit only the parameters that are named so. Repeat."),
]
Also = Annotated[
    list[str] | None,
    Option("--also", metavar="NAME[=LOW..HIGH]", help="Fit this parameter besides the usual ones. Repeat."),
]
Change = Annotated[list[str] | None, Option(metavar="NAME=VALUE", help="Change this parameter of the device. Repeat.")]
Frequencies = Annotated[
    str, Option(help="Frequencies of the actuators in Hz, - for still; drives separated by ; such as 150,130;-,90.")
]
Workers = Annotated[int | None, Option("--workers", min=1, max=64, help="Processes that work; default: one a core.")]
PortName = Annotated[
    str,
    Option(
        "--port",
        metavar="PORT",
        help="The board's port: a serial port as `list` shows it, or a sound card, audio:NAME,... (docs/audio.md).",
    ),
]
_BIT_RATES = 9_600, 12_000_000  # the slowest carries some commands a second, and the fastest is USB's full speed
BitRate = Annotated[
    int, Option("--bit-rate", min=_BIT_RATES[0], max=_BIT_RATES[1], help="Bit rate of the serial port, bit/s.")
]

_FINEST_PITCH_M = 1e-3  # what digitizers tell; half as fine a pitch is four times as many clicks
_HIGHEST_HZ = 1e5  # as device files
_Choice = TypeVar("_Choice", bound=Enum)


def need_switch(context: typer.Context, switch: str, is_given: bool, *names: str) -> None:
    """Refuse parameters that the command line gives although they mean nothing without a switch. Raises OptionError."""
    given = [each for each in names if (source := context.get_parameter_source(each)) and source.name == "COMMANDLINE"]
    if given and not is_given:
        shown = {each.name: each.opts[0] for each in context.command.params}
        idle = ", ".join(text if (text := shown[each]).startswith("-") else text.upper() for each in given)
        raise OptionError(f"{idle}: without {switch} there is nothing to set: give {switch} too")


class OptionError(TactableError):
    """The text of an option cannot be read; the message names the option, the text and an example."""


def refuse_existing(path: Path, other: str = "another output") -> None:
    """Refuse a file that is there already. Raises OptionError."""
    if path.exists() or path.is_symlink():
        raise OptionError(f"{path}: exists already and is not overwritten; choose {other}")


def names_in(text: str) -> list[str]:
    """Names between commas."""
    return [name.strip() for name in text.split(",") if name.strip()]


def read_zones(option: str, text: str) -> list[str]:
    """Names of at least one zone. Raises OptionError."""
    names = names_in(text)
    if not names:
        raise OptionError(f"{option} names no zone; give at least one, such as {option} I,III")
    return names


def read_placement(device: "Device", felt: str, quiet: str) -> "Placement":
    """Fingers such as "35 mm,IV"; a zone means its middle. Raises OptionError without a felt one, PlacementError."""
    from engine.touch import Placement

    return Placement.named(device, read_zones("--felt", felt), names_in(quiet))


def read_rules(
    path: Path | None, device: "Device", drives: str | None, tell: Callable[[str], None] = lambda _: None
) -> "Effects":
    """The rules of a file, by default a click for every touch; --drives, if it is given, replaces that of the file."""
    from engine.effects.rule_file import read_effects
    from engine.effects.rules import DEFAULT_EFFECTS
    from tactable.shipped import named_effects

    effects = DEFAULT_EFFECTS if path is None else read_effects(path, device, named_effects(), tell)
    return effects if drives is None else replace(effects, drives=read_drives_of(drives))


def read_drives_of(text: str | None) -> "Drives":
    """The option --drives; positions without it. Raises OptionError."""
    from engine.effects.rules import Drives

    return Drives.POSITIONS if text is None else read_choice("--drives", text, Drives)


def with_threshold(device: "Device", text: str | None) -> "Device":
    """The device with the curve of --threshold; None: its own. Raises DeviceError."""
    return device if text is None else device.with_threshold(Path(text) if text.endswith(".toml") else text)


def with_pressing(device: "Device", text: str | None) -> "Device":
    """As `with_threshold`, of a text that may end in a pressing force: "CURVE, 8 N". Raises OptionError as well."""
    curve, comma, force = (text or "").rpartition(",")
    if not comma:
        return with_threshold(device, text)
    if not (force_n := read_option("--threshold", force.strip(), "N")):
        raise OptionError(f"--threshold {text!r}: expected a force of more than 0 N, such as '{curve}, 8 N'")
    device = with_threshold(device, curve.strip())
    return replace(device, threshold=device.threshold.at_force(force_n))


def read_pitch(text: str | None) -> float | None:
    """A distance of places in metres; None: not given. Raises OptionError for one that no digitizer tells."""
    if text is None:
        return None
    pitch_m = read_option("--pitch", text, "m")
    if pitch_m < _FINEST_PITCH_M:
        raise OptionError(
            f"--pitch {text!r}: expected at least {1e3 * _FINEST_PITCH_M:g} mm; a table has clicks for every two places"
        )
    return pitch_m


def read_level(text: str) -> float:
    """A level in dB above the detection threshold; infinite is full scale. Raises OptionError."""
    if text.strip() in ("full", "inf"):
        return math.inf
    from engine.device.quantity import QuantityError, read_number
    from engine.device.toml_table import HIGHEST_LEVEL_DB

    try:
        level_db = read_number(text.removesuffix("dB"))
    except QuantityError:
        level_db = math.nan
    if not 0 <= level_db <= HIGHEST_LEVEL_DB:
        raise OptionError(f"--level {text!r}: expected 0 to {HIGHEST_LEVEL_DB:g} dB above threshold, or full")
    return level_db


def read_numbers(option: str, text: str, example: str = "1,0.6", mark: str = ",") -> list[float]:
    """Numbers between commas, or another mark. Raises OptionError."""
    from engine.device.quantity import QuantityError, read_number

    try:
        return [read_number(part) for part in names_in(text.replace(mark, ","))]
    except QuantityError:
        raise OptionError(f"{option} {text!r}: expected numbers, such as {option} {example}") from None


def read_counts(option: str, text: str, least: int, most: int) -> list[int]:
    """Different whole numbers between commas, in rising order. Raises OptionError."""
    try:
        counts = sorted({int(part) for part in names_in(text) if part.isascii() and "_" not in part})
    except ValueError:
        counts = []
    if not counts or not least <= counts[0] <= counts[-1] <= most:
        raise OptionError(f"{option} {text!r}: expected whole numbers from {least} to {most}, such as {least},{most}")
    return counts


def read_option(option: str, text: str, unit: str) -> float:
    """A quantity of at least 0 in SI units. Raises OptionError."""
    from engine.device.quantity import QuantityError, read_quantity

    try:
        value = read_quantity(text, unit)
    except QuantityError as error:
        raise OptionError(f"{option}: {error}") from None
    if value < 0:
        raise OptionError(f"{option} {text!r}: expected at least 0")
    return value


def read_choice(option: str, text: str, choices: type[_Choice]) -> _Choice:
    """One of the values of an enumeration. Raises OptionError."""
    for choice in choices:
        if choice.value == text:
            return choice
    raise OptionError(f"{option} {text!r}: expected one of {', '.join(choice.value for choice in choices)}")


def read_parameters(
    device: "Device", fit: Sequence[str] | None, also: Sequence[str] | None, usual: Sequence[str] | None = None
) -> tuple[tuple[str, ...], dict[str, "Bounds"]]:
    """Names to fit and their bounds in SI units, from texts such as "bar.density=2.6e3 kg/m^3..2.8e3 kg/m^3".

    `usual`: names without --fit, by default those of a fit to accelerations.
    Raises OptionError, and ParameterError for a name that the device does not have.
    """
    from precompute.measurements.parameters import default_names, parameter_unit

    bounds = {}
    names = [] if fit else list(default_names(device) if usual is None else usual)
    for option, texts in (("--fit", fit or []), ("--also", also or [])):
        for text in texts:
            name, _, limits = text.partition("=")
            if name not in names:
                names.append(name)
            if limits:
                unit = parameter_unit(device, name)
                low, separator, high = limits.partition("..")
                if not separator:
                    raise OptionError(f"{option} {name}={limits}: expected bounds such as 1 {unit}..2 {unit}")
                bounds[name] = (read_option(f"{option} {name}", low, unit), read_option(f"{option} {name}", high, unit))
    return tuple(names), bounds


def read_drives(text: str, device: "Device") -> list[list[float]]:
    """Frequencies (drive, actuator) in Hz of a text such as "150,130;140,-"; NaN: still. Raises OptionError."""
    drives = [[_read_frequency(part) for part in drive.split(",")] for drive in text.split(";") if drive.strip()]
    for drive in drives:
        if len(drive) != len(device.actuators) or all(math.isnan(hz) for hz in drive):
            names = ",".join(actuator.name for actuator in device.actuators)
            raise OptionError(f"--drives {text!r}: expected frequencies in Hz of {names}, - for still; such as 150,130")
    if not drives:
        raise OptionError("--drives names no drive; give at least one, such as 150,130")
    return drives


def _read_frequency(text: str) -> float:
    from engine.device.quantity import QuantityError, read_number

    if text.strip() == "-":
        return math.nan
    try:
        value = read_number(text)
    except QuantityError:
        value = math.nan
    if not 0 < value <= _HIGHEST_HZ:
        raise OptionError(f"--drives: {text!r}: expected a frequency of at most {_HIGHEST_HZ:g} Hz, or - for still")
    return value


def read_changes(texts: Sequence[str] | None, device: "Device") -> dict[str, float]:
    """Values in SI units by name, of texts such as "actuator[1].stiffness=20 kN/m". Raises OptionError."""
    from precompute.measurements.parameters import parameter_unit

    changes = {}
    for text in texts or ():
        name, _, value = text.partition("=")
        changes[name] = read_option(f"--change {name}", value, parameter_unit(device, name))
    return changes
