"""An effect to MPEG's haptic interchange format: clicks as transients, steady drives as waves with steps of amplitude.

Amplitude 1 stands for one level, and amplitudes are in proportion to what is felt: 6 dB less is half. What an effect
does not say, a frequency and a place, comes from the caller. The file is what the reader of MPEG's reference software
takes (github.com/MPEGGroup/HapticReferenceSoftware, source/IOHaptics/src/IOJson.cpp at 73ffe9bb): every member that it
asks for, the year of the standard as version, a date, and no type of curve on a band that has no curve.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from base.points import point_text
from engine.effects.files.conversion import CLICK_MS
from engine.effects.rules import NS_PER_MS, Effect, Segment

TICKS_PER_S = 1000
VERSION = "2023"
_LONGEST_MS = 32_000  # of one wave: a keyframe's position has 16 bits in the binary format, for some with a sign


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
        "timescale": TICKS_PER_S,
        "avatars": [],
        "perceptions": [perception],
        "syncs": [{"timestamp": 0, "timescale": TICKS_PER_S}],
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
