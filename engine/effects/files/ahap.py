"""Apple's haptic patterns (.ahap) to events.

A pattern is a list of events, each with fixed parameters, and of parameter curves that act on all events: the curve of
the intensity multiplies, that of the sharpness adds. As Core Haptics does, values out of range are clipped, missing
ones get their defaults, and unknown keys are passed over
(https://developer.apple.com/documentation/corehaptics/representing-haptic-patterns-in-ahap-files).
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from engine.effects.files.json_part import Part, clipped
from engine.effects.files.pattern import Budget, Event, Kind, Pattern

FORMAT = "ahap"
_INTENSITY_CURVE = "HapticIntensityControl"
_SHAPES = ("AttackTime", "DecayTime", "ReleaseTime", "Sustained")
"""Parameters of an event's own envelope, of which no exact course is published."""
_MOST_CURVES = 500
"""Each multiplies every point: a curve of Core Haptics has 16 points, so these are the curves of 8000."""
Curve = list[tuple[float, float]]


def read_ahap(document: Part) -> Pattern:
    """The events of a pattern. Raises EffectError."""
    curves, dynamic = list[Curve](), list[tuple[float, float]]()
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
                dynamic.append((_time(parameter), clipped(parameter.need("ParameterValue").number())))
            else:
                others.append(Event(item.path, Kind.OTHER, ((_time(parameter), 0.0),), reason=f"{kind} is not kept"))
        else:
            events.append(item)
    if len(curves) > _MOST_CURVES:
        raise document.error(f"at most {_MOST_CURVES} curves of the intensity")
    metadata = document.get("Metadata")
    description = None if metadata is None else metadata.get("Description") or metadata.get("Project")
    read = _along([_event(item, has_sharpness_curve) for item in events], curves, dynamic, document)
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


def _along(events: Sequence[Event], curves: Sequence[Curve], dynamic: Curve, document: Part) -> list[Event]:
    """The events with what all curves and dynamic parameters multiply them with: 1 before the first, held after."""
    courses = [np.array(curve).T for curve in curves if curve]
    steps_s, values = np.array([(-math.inf, 1.0), *sorted(dynamic)]).T
    # A dynamic parameter is a step: two points, the one just before it at the old value.
    bends_s = np.unique(np.concatenate([*(times_s for times_s, _ in courses), steps_s[1:], steps_s[1:] - 1e-6]))
    budget, parts = Budget(), [np.zeros(0)]
    for event in events:
        first, last = np.searchsorted(bends_s, (event.start_s, event.stop_s), side="right").tolist()
        budget.spend(2 + last - first, document)
        parts.append(np.unique([event.start_s, *bends_s[first:last], event.stop_s]))
    times_s = np.concatenate(parts)
    factor = values[np.searchsorted(steps_s, times_s, side="right") - 1]
    for curve_s, factors in courses:
        factor *= np.interp(times_s, curve_s, factors, left=1.0)
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
