"""MPEG's haptic interchange format (.hjif, ISO/IEC 23090-31) to events, and an effect to a file of it.

A file has perceptions, these have channels with a place on the body, and these have bands with effects at positions in
ticks. In a band of transients each keyframe is one; in a band of vectorial waves an effect is a sine whose amplitude
and frequency follow its keyframes; a band of curves has the signal itself, whose size stands for the amplitude. Bands
of wavelets hold coded samples and are not played. As the reference player has it, an amplitude is 1 where no keyframe
has one, the first is held from the start on, and the last until the last keyframe. Known from the files and the reader
of the reference software (github.com/MPEGGroup/HapticReferenceSoftware); a negative position is written there as a
16-bit one without its sign.

Written are clicks as transients, and steady drives as waves with steps of amplitude. Amplitude 1 stands for one level,
and amplitudes are in proportion to what is felt: 6 dB less is half. What an effect does not say, a frequency and a
place, comes from the caller. The file is what the reader of the reference software takes
(source/IOHaptics/src/IOJson.cpp at 73ffe9bb): every member that it asks for, the year of the standard as version, a
date, and no type of curve on a band that has no curve.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from base.points import point_text
from engine.effects.files.json_part import (
    CLICK_MS,
    LONGEST_S,
    LONGEST_WORD,
    Budget,
    Event,
    Kind,
    Part,
    Pattern,
    clipped,
)
from engine.effects.rules import NS_PER_MS, Effect, Segment

FORMAT = "hjif"
DEFAULT_TICKS_PER_S = 1000
_VIBRATIONS = ("Vibrotactile", "Vibration", "Other")
_MOST_EXPONENT = 9  # of ten, in the unit of amplitudes
_DEEPEST = 8  # composite effects in one another
VERSION = "2023"
_LONGEST_MS = 32_000  # of one wave: a keyframe's position has 16 bits in the binary format, for some with a sign
Library = Mapping[int, Part]


def read_hjif(document: Part) -> Pattern:
    """The events of a file. Raises EffectError."""
    ticks_per_s = document.number_of("timescale", DEFAULT_TICKS_PER_S)
    if not 0 < ticks_per_s <= 1e6:
        raise document.need("timescale").error("1 to 1 000 000 ticks a second")
    events, budget = list[Event](), Budget()
    for perception in document.need("perceptions").items():
        modality = perception.get("perception_modality")
        word = "Vibrotactile" if modality is None else modality.word()
        library = {part.need("id").whole(): part for part in perception.list_of("effect_library") if part.get("id")}
        exponent = perception.number_of("perception_unit_exponent", 0.0)
        unit = 10.0 ** min(max(exponent, -_MOST_EXPONENT), _MOST_EXPONENT)
        for channel in perception.list_of("channels") or perception.list_of("tracks"):
            events += _Channel(channel, word, library, ticks_per_s, unit, budget).events()
    return Pattern(FORMAT, document.text_of("description"), tuple(events))


class _Channel:
    """One channel of a perception, while it is read."""

    def __init__(
        self, part: Part, modality: str, library: Library, ticks_per_s: float, unit: float, budget: Budget
    ) -> None:
        self._part, self._modality, self._library, self._ticks_per_s = part, modality, library, ticks_per_s
        self._budget = budget
        self._gain = unit * part.number_of("gain", 1.0)
        self._place = _place_of(part)

    def events(self) -> Iterator[Event]:
        """All of its events."""
        for band in self._part.list_of("bands"):
            band_type = band.need("band_type").word()
            for effect in band.list_of("effects"):
                yield from self._effect(effect, band_type, 0.0, 0)

    def _effect(self, part: Part, band_type: str, start_ticks: float, depth: int) -> Iterator[Event]:
        self._budget.spend(1, part)
        own_ticks = start_ticks + part.number_of("position", 0.0)
        word = part.text_of("effect_type", "Basis")
        if word == "Reference":
            number = part.need("id")
            found = self._library.get(number.whole())
            if found is None or depth == _DEEPEST:
                raise number.error("an effect of the library, and none that refers to itself")
            inner = Part(part.source, part.path, found.value)
            yield from self._effect(inner, band_type, own_ticks - found.number_of("position", 0.0), depth + 1)
        elif word == "Composite":
            if depth == _DEEPEST:
                raise part.error(f"at most {_DEEPEST} effects in one another")
            inner_effects = part.list_of("composition") or part.list_of("effects")
            for each in inner_effects:
                yield from self._effect(each, band_type, own_ticks, depth + 1)
        else:
            yield from self._basis(part, band_type, own_ticks)

    def _basis(self, part: Part, band_type: str, start_ticks: float) -> Iterator[Event]:
        at_s = self._seconds(part, start_ticks)
        if self._modality not in _VIBRATIONS:
            yield Event(part.path, Kind.OTHER, ((at_s, 0.0),), reason=f"{self._modality} is no vibration")
            return
        if band_type not in ("Transient", "VectorialWave", "Curve"):
            yield Event(part.path, Kind.OTHER, ((at_s, 0.0),), reason=f"a band of {band_type} holds coded samples")
            return
        points, frequencies, times_s = [], [], [at_s]
        keyframes = part.list_of("keyframes")
        self._budget.spend(len(keyframes), part)
        for keyframe in keyframes:
            offset_ticks = _signed(keyframe.number_of("relative_position", 0.0))
            times_s.append(self._seconds(keyframe, start_ticks + offset_ticks))
            amplitude, frequency = keyframe.get("amplitude_modulation"), keyframe.get("frequency_modulation")
            if frequency is not None:
                frequencies.append(frequency.number())
            if amplitude is not None:
                size = clipped(abs(amplitude.number() * self._gain))
                points.append((times_s[-1], size, keyframe, frequency))
        if not keyframes or (band_type == "Transient" and not points):
            yield Event(part.path, Kind.OTHER, ((at_s, 0.0),), reason="it has no keyframe with an amplitude")
        elif band_type == "Transient":
            for time_s, size, keyframe, frequency in points:
                of_one = [] if frequency is None else [frequency.number()]
                yield Event(keyframe.path, Kind.TRANSIENT, ((time_s, size),), self._unused(of_one))
        else:
            course = sorted(((time_s, size) for time_s, size, *_ in points), key=lambda point: point[0])
            course = course or [(at_s, clipped(abs(self._gain)))]
            if at_s < course[0][0]:
                course.insert(0, (at_s, course[0][1]))
            if course[-1][0] < max(times_s):
                course.append((max(times_s), course[-1][1]))
            more = ("the signal's own course",) if band_type == "Curve" else ()
            yield Event(part.path, Kind.CONTINUOUS, tuple(course), (*self._unused(frequencies), *more))

    def _seconds(self, part: Part, ticks: float) -> float:
        """A time; one before the start is at the start, as it can be played no earlier."""
        time_s = max(0.0, ticks / self._ticks_per_s)
        if time_s > LONGEST_S:
            raise part.error(f"at most {LONGEST_S:g} s")
        return time_s

    def _unused(self, frequencies: list[float]) -> tuple[str, ...]:
        texts = []
        if frequencies:
            low, high = min(frequencies), max(frequencies)
            texts.append(f"frequency {low:g} Hz" if low == high else f"frequency {low:g} to {high:g} Hz")
        return (*texts, self._place) if self._place else tuple(texts)


def _signed(ticks: float) -> float:
    return ticks - 65_536 if 32_768 <= ticks < 65_536 and ticks == round(ticks) else ticks


def _place_of(channel: Part) -> str:
    """The place that a channel is for, in words."""
    name = channel.text_of("description")[:LONGEST_WORD]
    mask, vertices = channel.get("body_part_mask"), channel.get("vertices")
    where = [] if mask is None else [f"body parts {mask.whole():#x}"]
    where += [] if vertices is None else [f"{len(list(vertices.items()))} vertices"]
    return f"place {', '.join([*([name] if name else []), *where])}" if name or where else ""


@dataclass(frozen=True)
class EffectPlace:
    """Where on which surface the effect is to be felt, and what its actuators can do there."""

    device: str
    at_m: complex
    band_hz: tuple[float, float]
    best_hz: float  # the frequency at which the place is moved most for the threshold


def encode_hjif(
    effect: Effect, full_level_db: float, hold_ms: int, date: str, place: EffectPlace | None = None
) -> dict[str, Any]:
    """The document (to be written as JSON); a held segment lasts `hold_ms`, `date` is of ISO 8601 (2026-01-31)."""
    lower, upper = (0, 1000) if place is None else (round(place.band_hz[0]), round(place.band_hz[1]))
    limits = {"lower_frequency_limit": lower, "upper_frequency_limit": upper}
    pitch = {} if place is None else {"frequency_modulation": round(place.best_hz)}
    clicks, waves = [], []
    for run in _runs(effect.envelope, hold_ms):
        start_ms, (first, _) = run[0][0], run[0][1:]
        if first.is_click:
            frame = {"relative_position": 0, "amplitude_modulation": _amplitude(first, full_level_db), **pitch}
            clicks.append(_basis(start_ms, [frame]))
        else:
            waves.append(_basis(start_ms, _keyframes(run, full_level_db, pitch)))
    bands = [
        {"band_type": band_type, **limits, "effects": effects}
        for band_type, effects in (("Transient", clicks), ("VectorialWave", waves))
        if effects
    ]
    where = "a touch surface" if place is None else f"{place.device}, at {point_text(place.at_m)}"
    channel = {"id": 0, "description": where, "gain": 1.0, "mixing_coefficient": 1.0, "body_part_mask": 0}
    channel |= {"bands": bands} if place is None else {"bands": bands, "reference_device_id": 0}
    devices = [] if place is None else [_reference_device(place)]
    perception = {
        "id": 0,
        "avatar_id": 0,
        "description": effect.name,
        "perception_modality": "Vibrotactile",
        "unit_exponent": -3,
        "perception_unit_exponent": 0,
        "reference_devices": devices,
        "effect_library": [],
        "channels": [channel],
    }
    return {
        "version": VERSION,
        "profile": "Main",
        "level": 1,
        "date": date,
        "description": effect.name,
        "timescale": DEFAULT_TICKS_PER_S,
        "avatars": [],
        "perceptions": [perception],
        "syncs": [{"timestamp": 0, "timescale": DEFAULT_TICKS_PER_S}],
    }


def _runs(segments: Sequence[Segment], hold_ms: int) -> Iterator[list[tuple[int, Segment, int]]]:
    """Each click, and each stretch of steady segments without a pause: (start, segment, length) in ms."""
    at_ms, run = 0, list[tuple[int, Segment, int]]()
    for segment in segments:
        length_ms = hold_ms if segment.duration_ns is None else round(segment.duration_ns / NS_PER_MS)
        length_ms = CLICK_MS if segment.is_click else length_ms
        if run and (segment.is_click or segment.level_db is None):
            yield run
            run = []
        if segment.is_click:
            yield [(at_ms, segment, length_ms)]
        elif segment.level_db is not None:
            for start_ms in range(at_ms, at_ms + length_ms, _LONGEST_MS):
                part_ms = min(_LONGEST_MS, at_ms + length_ms - start_ms)
                if run and start_ms + part_ms - run[0][0] > _LONGEST_MS:
                    yield run
                    run = []
                run.append((start_ms, segment, part_ms))
        at_ms += length_ms
    if run:
        yield run


def _keyframes(
    run: Sequence[tuple[int, Segment, int]], full_level_db: float, pitch: dict[str, int]
) -> list[dict[str, Any]]:
    """Two keyframes a step, since amplitudes run in straight lines between keyframes; a step begins where one ends."""
    frames, begin_ms = list[dict[str, Any]](), run[0][0]
    for start_ms, segment, length_ms in run:
        first, last = start_ms - begin_ms, start_ms - begin_ms + length_ms
        amplitude = _amplitude(segment, full_level_db)
        frames += [{"relative_position": at, "amplitude_modulation": amplitude, **pitch} for at in (first, last)]
    return frames


def _basis(position: int, keyframes: list[dict[str, Any]]) -> dict[str, Any]:
    return {"effect_type": "Basis", "position": position, "phase": 0.0, "base_signal": "Sine", "keyframes": keyframes}


def _amplitude(segment: Segment, full_level_db: float) -> float:
    assert segment.level_db is not None  # a pause is no part of a run
    return 1.0 if math.isinf(segment.level_db) else min(1.0, 10 ** ((segment.level_db - full_level_db) / 20))


def _reference_device(place: EffectPlace) -> dict[str, Any]:
    low_hz, high_hz = place.band_hz
    return {
        "id": 0,
        "name": place.device,
        "body_part_mask": 0,
        "minimum_frequency": low_hz,
        "maximum_frequency": high_hz,
        "resonance_frequency": place.best_hz,
    }
