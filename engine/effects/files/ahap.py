"""Apple's haptic patterns (.ahap) to events.

A pattern is a list of events, each with fixed parameters, and of parameters and parameter curves that act on all
events: that of the intensity multiplies, that of the sharpness adds. Each of them sets one value, which holds until the
next one begins; longer courses are chains of curves, which have at most 16 points each. As Core Haptics does, values
out of range are clipped, missing ones get their defaults, and unknown keys are passed over
(https://developer.apple.com/documentation/corehaptics/representing-haptic-patterns-in-ahap-files).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from engine.effects.files.json_part import LONGEST_WORD, Budget, Event, Kind, Part, Pattern, clipped

FORMAT = "ahap"
_INTENSITY_CURVE = "HapticIntensityControl"
_SHAPES = ("AttackTime", "DecayTime", "ReleaseTime", "Sustained")  # without a published course
_JUST_S = 1e-6  # so long before a value is replaced it is still there
Curve = list[tuple[float, float]]


def read_ahap(document: Part) -> Pattern:
    """The events of a pattern. Raises EffectError."""
    curves = list[Curve]()
    events, others, has_sharpness_curve = list[Part](), list[Event](), False
    for item in document.need("Pattern").items():
        if (curve := item.get("ParameterCurve")) is not None:
            kind = curve.need("ParameterID").word()
            if kind == _INTENSITY_CURVE:
                curves.append(_curve(curve))
            has_sharpness_curve |= kind == "HapticSharpnessControl"
        elif (parameter := item.get("Parameter")) is not None:
            kind = parameter.need("ParameterID").word()
            if kind == _INTENSITY_CURVE:
                curves.append([(_time(parameter), clipped(parameter.need("ParameterValue").number()))])
            else:
                others.append(Event(item.path, Kind.OTHER, ((_time(parameter), 0.0),), reason=f"{kind} is not kept"))
        elif item.get("Event") is not None:
            events.append(item)
        else:
            keys = ", ".join(map(str, item.value))[:LONGEST_WORD]
            others.append(Event(item.path, Kind.OTHER, ((0.0, 0.0),), reason=f"no event or parameter, but {keys}"))
    metadata = document.get("Metadata")
    description = None if metadata is None else metadata.get("Description") or metadata.get("Project")
    read = _along([_event(item, has_sharpness_curve) for item in events], _control(curves), document)
    return Pattern(FORMAT, "" if description is None else description.text(), (*read, *others))


def _time(part: Part) -> float:
    time = part.get("Time")
    return 0.0 if time is None else time.time_s()


def _curve(curve: Part) -> Curve:
    """The control points, times from the start of the pattern."""
    start_s = _time(curve)
    points = [
        (start_s + _time(point), clipped(point.need("ParameterValue").number()))
        for point in curve.need("ParameterCurveControlPoints").items()
    ]
    return sorted(points, key=lambda point: point[0])


def _control(curves: Sequence[Curve]) -> Curve:
    """What all intensities are multiplied with, 1 before the first curve: each replaces the one before as it begins."""
    chain = sorted(filter(None, curves), key=lambda curve: curve[0][0])
    if not chain:
        return [(0.0, 1.0)]
    course = [(chain[0][0][0] - _JUST_S, 1.0)]
    for curve, begin_s in zip(chain, [*(after[0][0] for after in chain[1:]), np.inf], strict=True):
        kept = [point for point in curve if point[0] < begin_s]
        if kept and kept[-1][0] < begin_s - _JUST_S < np.inf:
            kept.append((begin_s - _JUST_S, float(np.interp(begin_s - _JUST_S, *np.array(curve).T))))
        course += kept
    return course


def _along(events: Sequence[Event], control: Curve, document: Part) -> list[Event]:
    """The events with what the course of the control multiplies them with."""
    bends_s, values = np.array(control).T
    budget, parts = Budget(), [np.zeros(0)]
    for event in events:
        first, last = np.searchsorted(bends_s, (event.start_s, event.stop_s), side="right").tolist()
        budget.spend(2 + last - first, document)
        parts.append(np.unique([event.start_s, *bends_s[first:last], event.stop_s]))
    factor = np.interp(np.concatenate(parts), bends_s, values)
    of_each = np.split(factor, np.cumsum([len(part) for part in parts])[:-1])
    return [
        replace(event, points=tuple(zip(part.tolist(), (event.peak * factors).tolist(), strict=True)))
        for event, part, factors in zip(events, parts[1:], of_each[1:], strict=True)
    ]


def _event(item: Part, has_sharpness_curve: bool) -> Event:
    """The event by itself: its own intensity from start to stop."""
    part = item.need("Event")
    kind, start_s = part.need("EventType").word(), _time(part)
    if kind not in ("HapticTransient", "HapticContinuous"):
        return Event(item.path, Kind.OTHER, ((start_s, 0.0),), reason=f"{kind} is no vibration")
    parameters = {
        each.need("ParameterID").text(): each.need("ParameterValue").number()
        for each in part.list_of("EventParameters")
    }
    own = clipped(parameters.get("HapticIntensity", 1.0))
    unused = [f"sharpness {parameters['HapticSharpness']:g}"] if "HapticSharpness" in parameters else []
    unused += ["curve of the sharpness"] if has_sharpness_curve else []
    unused += [f"{name} {parameters[name]:g}" for name in _SHAPES if parameters.get(name)]
    duration = part.get("EventDuration") if kind == "HapticContinuous" else None
    stop_s = start_s + (0.0 if duration is None else duration.time_s())
    points = ((start_s, own), (stop_s, own))
    return Event(item.path, Kind.TRANSIENT if kind == "HapticTransient" else Kind.CONTINUOUS, points, tuple(unused))
