"""Commands `effects ...`: effect files of other makers read, shown and written, and what a place can do."""

import json
import math
from datetime import date
from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Argument, Option

from base.files import write_text
from base.points import json_of
from engine.device import Device
from engine.effects.files.conversion import FORMATS, FULL_LEVEL_DB, Converted, Fate, read_effect_file
from engine.effects.rules import NS_PER_MS, Effect, EffectError, Segment
from tactable.cli.console import EXIT_DOUBTFUL, print_json, say
from tactable.cli.options import AsJson, DeviceArgument, OptionError, names_in, read_level
from tactable.shipped import find_device, named_effects

_ENDINGS = ", ".join(f".{each}" for each in FORMATS)
_WRITTEN = ".hjif"
FullLevel = Annotated[str, Option("--level", help="Level of the file's greatest intensity, 1, in dB above threshold.")]
_DEFAULT_LEVEL = f"{FULL_LEVEL_DB:g}"
_HOLD_MS = 1000  # of a segment without a length, which such a file cannot have


def show(
    name: Annotated[
        str, Argument(metavar="EFFECT", help=f"An effect file, {_ENDINGS}; to be written also a named effect.")
    ],
    output: Annotated[
        list[Path] | None, Option("-o", "--output", help="A picture, its data .csv, or .hjif. Repeat for more.")
    ] = None,
    level: FullLevel = _DEFAULT_LEVEL,
    device_name: Annotated[str | None, Option("--device", help="Of a .hjif file: the device that it is for.")] = None,
    at: Annotated[str | None, Option("--at", help="Of a .hjif file: the place on it, 40mm or 40x60mm.")] = None,
    as_json: AsJson = False,
) -> None:
    """Read an effect file, say of each event whether it is played, draw or write it.

    An event is kept, changed (in time or length, or interrupted), joined with another event's click, or lost. What no
    event keeps is listed too: the placement of the fingers decides the frequency, and the rules decide the place.
    Exit status 3 says that an event is lost.

    With -o NAME.hjif it is written as an MPEG haptic file; --device and --at add its place and the frequency that moves
    this place most. A segment that lasts while the finger rests is written with a length of 1 s.
    """
    written = [path for path in output or [] if path.suffix.lower() == _WRITTEN]
    for path in written:
        _write_hjif(path, name, level, device_name, at)
    if (device_name or at) and not written:
        raise OptionError(f"--device and --at are of a file that is written: add -o NAME{_WRITTEN}")
    if written and written == output:
        return
    full_level_db, path = _read_level(level), Path(name)
    converted = read_effect_file(path, path.stem, full_level_db)
    if output:
        from tactable.figures.effect_file import plot_effect_file
        from tactable.figures.picture_file import outputs_of, write_outputs

        outputs = outputs_of([path for path in output if path not in written])
        write_outputs(plot_effect_file(converted, full_level_db), outputs)
    if as_json:
        print_json(_plain(converted, full_level_db))
    else:
        _print(converted)
    if converted.number(Fate.LOST):
        raise typer.Exit(EXIT_DOUBTFUL)


def _write_hjif(path: Path, name: str, level: str, device_name: str | None, at: str | None) -> None:
    from engine.effects.files.hjif import encode_hjif

    if (device_name is None) != (at is None):
        raise OptionError("--device and --at go together, such as --device reference-a --at 40mm")
    effect, full_level_db = _effect(name, level), _read_level(level)
    highest_db = max(s.level_db for s in effect.envelope if s.level_db is not None)
    if math.isfinite(highest_db):
        full_level_db = max(full_level_db, highest_db)
    place = None if device_name is None or at is None else _place(device_name, at)
    document = encode_hjif(effect, full_level_db, _HOLD_MS, date.today().isoformat(), place)
    write_text(path, json.dumps(document, indent=1) + "\n")
    say(f"{path}: {effect.name}; amplitude 1 stands for {full_level_db:g} dB")


def curve(
    device_name: DeviceArgument,
    at: Annotated[str, Option("--at", help="Places: 40mm,140mm or 40x60mm; default: the middle of each zone.")] = "",
    path: Annotated[Path | None, Option("-o", "--output", help="A .json file; default: print.")] = None,
    under_finger: Annotated[bool, Option("--finger/--no-finger", help="With the device's finger there.")] = True,
) -> None:
    """Write the greatest acceleration of places by frequency, as for Android.

    Each place has a list of frequencyHz and maxOutputAccelerationGs (peak, in g) as in android.hardware.vibrator's
    FrequencyAccelerationMapEntry: what all actuators together give there at full scale.
    """
    import numpy as np

    from precompute.model.assembly import assemble
    from precompute.studies.reach_along import compute_acceleration_curves

    device = find_device(device_name)
    places_m = [_read_place(device, each) for each in names_in(at)] or [zone.middle_m for zone in device.zones]
    finger = device.finger if under_finger else None
    hz, g = compute_acceleration_curves(assemble(device), np.array(places_m), finger)
    document = {
        "device": device.name,
        "fingerprint": device.fingerprint,
        "finger": under_finger,
        "estimated": list(device.estimated_values),
        "places": [
            {
                "at_m": json_of(place_m),
                "frequencyToOutputAccelerationMap": [
                    {"frequencyHz": float(f), "maxOutputAccelerationGs": float(f"{value:.6g}")}
                    for f, value in zip(hz, column, strict=True)
                ],
            }
            for place_m, column in zip(places_m, g.T, strict=True)
        ],
    }
    if path is None:
        print_json(document)
        return
    write_text(path, json.dumps(document, indent=1) + "\n")
    say(f"{path}: {len(places_m)} places of {device.name}, {hz[0]:g} to {hz[-1]:g} Hz; computed, not measured")


def _read_level(text: str) -> float:
    level_db = read_level(text)
    if math.isinf(level_db):
        raise OptionError(f"--level {text!r}: expected dB above threshold, such as 25: an intensity needs a level")
    return level_db


def _effect(name: str, level: str) -> Effect:
    """A named effect, or that of a file. Raises EffectError."""
    named = named_effects()
    if name in named:
        return named[name]
    if not Path(name).is_file():
        raise EffectError(f"{name}: is neither an effect file nor a named effect; named are {', '.join(named)}")
    return read_effect_file(Path(name), Path(name).stem, _read_level(level)).effect


def _place(device_name: str, at: str) -> Any:
    import numpy as np

    from engine.effects.files.hjif import EffectPlace
    from precompute.model.assembly import assemble
    from precompute.studies.reach_along import compute_reach

    device = find_device(device_name)
    at_m = _read_place(device, at)
    reach = compute_reach(assemble(device), np.array([at_m]), device.finger)
    bands = [actuator.band_hz for actuator in device.actuators]
    band_hz = (min(low for low, _ in bands), max(high for _, high in bands))
    return EffectPlace(device.name, at_m, band_hz, float(reach.one_tone_hz[0]))


def _read_place(device: Device, text: str) -> complex:
    from engine.device.quantity import QuantityError, read_point_on

    try:
        return read_point_on(text, device.surface.corner_m)
    except QuantityError as error:
        raise OptionError(f"--at: {error}") from None


def _plain(converted: Converted, full_level_db: float) -> dict[str, Any]:
    return {
        "effect": converted.name,
        "format": converted.pattern.format,
        "description": converted.pattern.description,
        "full_level_db": full_level_db,
        "counts": {str(fate): converted.number(fate) for fate in Fate},
        "envelope": [_segment_text(segment) for segment in converted.segments],
        "events": [report.plain() for report in converted.reports],
    }


def _segment_text(segment: Segment) -> list[str]:
    """A segment as a rule file states it."""
    duration = "click" if segment.is_click else f"{(segment.duration_ns or 0) // NS_PER_MS} ms"
    return [duration, "quiet" if segment.level_db is None else f"{segment.level_db:g} dB"]


def _print(converted: Converted) -> None:
    say(f"{converted.name} ({converted.pattern.format}): {converted.summary}")
    for report in converted.reports:
        event = report.event
        without = [f"without {', '.join(event.unused)}"] if event.unused else []
        what = "; ".join([*([report.played] if report.played else []), *report.notes, *without])
        say(f"  {1e3 * event.start_s:7.0f} ms  {event.kind:<10}  {report.fate:<7}  {what}  ({event.source})")
    unused = dict.fromkeys(each.split(" ")[0] for report in converted.reports for each in report.event.unused)
    reasons = {
        "sharpness": "sharpness: the placement of the fingers decides the frequency",
        "frequency": "frequency: the placement of the fingers decides it",
        "curve": "curve of frequency or sharpness: the placement of the fingers decides the frequency",
        "place": "place: the rule that names the effect decides which finger feels it",
    }
    for each in unused:
        say(f"  {reasons.get(each, each)}")
