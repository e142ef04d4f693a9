"""Meta's haptic clips (.haptic) to events.

A clip has one envelope of the amplitude and one of the frequency, both straight lines between points. The amplitude
rises from 0 at the start to a first point that comes later. A point of the amplitude may have an emphasis, which is a
transient. Each stretch of the envelope above 0 is one continuous event.
"""

from itertools import pairwise

from engine.effects.files.json_part import Event, Kind, Part, Pattern, clipped
from engine.effects.rules import EffectError

FORMAT = "haptic"


def read_haptic(document: Part) -> Pattern:
    """The events of a clip. Raises EffectError."""
    major = document.need("version").need("major")
    if major.number() != 1:
        raise major.error("1: no other version of this format is known")
    envelopes = document.need("signals").need("continuous").need("envelopes")
    unused = ("curve of the frequency",) if envelopes.list_of("frequency") else ()
    points: list[tuple[float, float]] = []
    transients = []
    for part in envelopes.need("amplitude").items():
        time_s = part.need("time").time_s()
        if points and time_s < points[-1][0]:
            raise EffectError(f"{part.source}: {part.path}.time: {time_s:g}: expected no time before the last point's")
        points.append((time_s, clipped(part.need("amplitude").number())))
        if (emphasis := part.get("emphasis")) is not None:
            peak = clipped(emphasis.need("amplitude").number())
            frequency = emphasis.get("frequency")
            more = () if frequency is None else (f"frequency {frequency.number():g} of 1",)
            transients.append(Event(f"amplitude[{len(points) - 1}].emphasis", Kind.TRANSIENT, ((time_s, peak),), more))
    added = [(0.0, 0.0)] if points and points[0][0] > 0 else []
    metadata = document.get("metadata")
    description = "" if metadata is None else metadata.text_of("project")
    return Pattern(FORMAT, description, (*transients, *_stretches([*added, *points], unused, len(added))))


def _stretches(points: list[tuple[float, float]], unused: tuple[str, ...], added: int) -> list[Event]:
    """The stretches of an envelope above 0, parted where it touches 0; `added` points precede the file's first."""
    runs: list[list[int]] = []
    for number, (before, after) in enumerate(pairwise(points)):
        if before[1] == after[1] == 0:
            continue
        if runs and runs[-1][-1] == number and before[1] > 0:
            runs[-1].append(number + 1)
        else:
            runs.append([number, number + 1])
    return [
        Event(
            f"amplitude[{max(run[0] - added, 0)}..{run[-1] - added}]",
            Kind.CONTINUOUS,
            tuple(points[number] for number in run),
            unused,
        )
        for run in runs
    ]
