"""Apple's haptic patterns (.ahap) to events.

A pattern is a list of events, each with fixed parameters, and of parameter curves that act on all events: the curve of
the intensity multiplies, that of the sharpness adds. As Core Haptics does, values out of range are clipped, missing
ones get their defaults, and unknown keys are passed over
(https://developer.apple.com/documentation/corehaptics/representing-haptic-patterns-in-ahap-files).
"""

from bisect import bisect_right
from collections.abc import Iterable, Sequence

from engine.effects.files.json_part import Part, clipped
from engine.effects.files.pattern import Event, Kind, Pattern

FORMAT = "ahap"
_INTENSITY_CURVE = "HapticIntensityControl"
_SHAPES = ("AttackTime", "DecayTime", "ReleaseTime", "Sustained")
"""Parameters of an event's own envelope, of which no exact course is published."""
Curve = list[tuple[float, float]]


def read_ahap(document: Part) -> Pattern:
    """The events of a pattern. Raises EffectError."""
    intensity: list[Curve] = []
    dynamic: list[tuple[float, float]] = []
    events, others, has_sharpness_curve = [], [], False
    for item in document.need("Pattern").items():
        if (curve := item.get("ParameterCurve")) is not None:
            if curve.need("ParameterID").text() == _INTENSITY_CURVE:
                intensity.append(_curve(curve))
            has_sharpness_curve |= curve.need("ParameterID").text() == "HapticSharpnessControl"
        elif (parameter := item.get("Parameter")) is not None:
            kind = parameter.need("ParameterID").text()
            if kind == _INTENSITY_CURVE:
                dynamic.append((_time(parameter), clipped(parameter.need("ParameterValue").number())))
            else:
                others.append(Event(item.path, Kind.OTHER, ((_time(parameter), 0.0),), reason=f"{kind} is not kept"))
        else:
            events.append(item)
    dynamic.sort()
    metadata = document.get("Metadata")
    description = None if metadata is None else metadata.get("Description") or metadata.get("Project")
    read = [_event(item, intensity, dynamic, has_sharpness_curve) for item in events]
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


def _event(item: Part, curves: list[Curve], dynamic: Curve, has_sharpness_curve: bool) -> Event:
    part = item.need("Event")
    kind, start_s = part.need("EventType").text(), _time(part)
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
    times_s = [start_s]
    if kind == "HapticContinuous":
        duration = part.get("EventDuration")
        stop_s = start_s + (0.0 if duration is None else duration.time_s())
        bends_s = {time_s for curve in curves for time_s, _ in curve if start_s < time_s < stop_s}
        # A dynamic parameter is a step: two points, the one just before it at the old value.
        steps_s = {time_s for time_s, _ in dynamic if start_s < time_s < stop_s}
        times_s = sorted({start_s, stop_s} | bends_s | steps_s | {max(start_s, time_s - 1e-6) for time_s in steps_s})
    points = tuple((time_s, own * _factor(curves, dynamic, time_s)) for time_s in times_s)
    return Event(item.path, Kind.TRANSIENT if kind == "HapticTransient" else Kind.CONTINUOUS, points, tuple(unused))


def _factor(curves: Iterable[Curve], dynamic: Curve, time_s: float) -> float:
    """What all curves and dynamic parameters multiply an intensity with: 1 before the first, held after the last."""
    factor = 1.0
    for curve in curves:
        if curve and time_s >= curve[0][0]:
            factor *= interpolated(curve, time_s)
    before = bisect_right(dynamic, (time_s, 1.0))
    return factor * (dynamic[before - 1][1] if before else 1.0)


def interpolated(points: Sequence[tuple[float, float]], time_s: float) -> float:
    """The value at a time, on straight lines between points in order of time; held before the first and after."""
    after = bisect_right(points, time_s, key=lambda point: point[0])
    if after in (0, len(points)):
        return points[min(after, len(points) - 1)][1]
    (start_s, start), (stop_s, stop) = points[after - 1], points[after]
    return start + (stop - start) * (time_s - start_s) / (stop_s - start_s)
