"""Laws of the conversion: clicks at their times, envelopes in steps, and a report for whatever cannot be kept."""

import math
import re
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from engine.effects.files.conversion import FULL_LEVEL_DB, Converted, Fate, convert, decode_effect_file
from engine.effects.files.hjif import EffectPlace, encode_hjif
from engine.effects.files.json_part import CLICK_MS, Event, Kind, Part, Pattern
from engine.effects.rules import NS_PER_MS, Effect, EffectError, Segment
from tactable.shipped import named_effects

MS = NS_PER_MS


def tap(at_ms: float, intensity: float = 1.0) -> Event:
    return Event(f"tap {at_ms:g}", Kind.TRANSIENT, ((at_ms / 1e3, intensity),))


def hum(*points: tuple[float, float]) -> Event:
    return Event(f"hum {points[0][0]:g}", Kind.CONTINUOUS, tuple((at_ms / 1e3, size) for at_ms, size in points))


def converted(*events: Event, full_level_db: float = FULL_LEVEL_DB) -> Converted:
    return convert(Pattern("ahap", "", events), "made", full_level_db)


def spans(segments: tuple[Segment, ...]) -> list[tuple[int, int, float, bool]]:
    """(start, stop, level, is_click) in ms of what is felt."""
    found, at_ms = [], 0
    for segment in segments:
        length_ms = CLICK_MS if segment.duration_ns is None else segment.duration_ns // MS
        if segment.level_db is not None:
            found.append((at_ms, at_ms + length_ms, segment.level_db, segment.is_click))
        at_ms += length_ms
    return found


def test_transients_are_clicks_at_their_times_and_half_the_intensity_is_6_db_less() -> None:
    made = converted(tap(5), tap(100, 0.5), tap(300, 0.25))
    assert spans(made.segments) == [(5, 35, 25.0, True), (100, 130, 19.0, True), (300, 330, 13.0, True)]
    assert made.number(Fate.KEPT) == 3 and made.summary == "3 events: 3 kept"


@pytest.mark.parametrize(
    ("second_ms", "fate", "clicks"), [(35, Fate.KEPT, 2), (22, Fate.CHANGED, 2), (12, Fate.JOINED, 1)]
)
def test_a_click_too_soon_after_another_is_moved_or_joined(second_ms: float, fate: Fate, clicks: int) -> None:
    made = converted(tap(0, 0.5), tap(second_ms))
    assert made.reports[1].fate is fate and len(spans(made.segments)) == clicks
    if fate is Fate.CHANGED:
        assert made.reports[1].notes == ["8 ms later, as the click before lasts 30 ms"]
    if fate is Fate.JOINED:
        assert spans(made.segments)[0][2] == 25.0  # the greater level
        assert made.reports[1].notes == ["12 ms after the click of tap 0"]


def test_an_envelope_is_played_in_steps_within_2_db_of_it() -> None:
    made = converted(hum((0, 1.0), (300, 0.1), (900, 0.5)))
    steps = spans(made.segments)
    assert steps[0][0] == 0 and steps[-1][1] == 900 and len(steps) > 8
    for start, stop, level_db, is_click in steps:
        middle = (start + stop) / 2
        intensity = 1.0 - 0.9 * middle / 300 if middle < 300 else 0.1 + 0.4 * (middle - 300) / 600
        assert not is_click and abs(level_db - FULL_LEVEL_DB - 20 * math.log10(intensity)) < 2.0
    assert made.number(Fate.KEPT) == 1


def test_a_click_takes_the_place_of_a_drive_and_the_drive_goes_on() -> None:
    made = converted(hum((0, 0.5), (400, 0.5)), tap(200))
    assert spans(made.segments) == [(0, 200, 19.0, False), (200, 230, 25.0, True), (230, 400, 19.0, False)]
    assert made.reports[0].notes == ["clicks take the place of 30 ms"]


def test_of_two_envelopes_the_stronger_is_played_and_the_other_is_reported() -> None:
    made = converted(hum((0, 0.2), (400, 0.2)), hum((100, 0.8), (200, 0.8)), hum((110, 0.1), (180, 0.1)))
    assert [fate.fate for fate in made.reports] == [Fate.CHANGED, Fate.KEPT, Fate.LOST]
    assert made.reports[0].notes == ["others are as strong or stronger for 100 ms"]
    assert "70 ms" in made.reports[2].notes[0]


def test_what_is_not_felt_is_lost_by_name() -> None:
    sound = Event("Pattern[9]", Kind.OTHER, ((0.0, 0.0),), reason="AudioCustom is no vibration")
    made = converted(tap(0, 0.01), hum((50, 0.01), (400, 0.02)), hum((500, 0.5), (530, 0.5)), sound)
    assert [report.fate for report in made.reports] == [Fate.LOST, Fate.LOST, Fate.CHANGED, Fate.LOST]
    assert made.reports[0].notes == ["intensity 0.01 is below the threshold"]
    assert made.reports[2].notes == ["its 30 ms are a click of 30 ms"]
    assert made.reports[3].notes == ["AudioCustom is no vibration"]
    assert converted(tap(0, 0.01), full_level_db=60.0).number(Fate.KEPT) == 1
    with pytest.raises(EffectError, match="made: its file has no event that is felt"):
        _ = converted(sound).effect


def test_events_that_last_too_long_together_and_too_many_segments_are_refused() -> None:
    assert converted(*[hum((0.0, 1.0), (120_000.0, 1.0))] * 10).segments
    with pytest.raises(EffectError, match="its events last 1320 s in all; expected at most 1200 s"):
        converted(*[hum((0.0, 1.0), (120_000.0, 1.0))] * 11)
    with pytest.raises(EffectError, match="2999 segments; expected at most 1024"):
        converted(*[tap(40 * number) for number in range(1500)])


EVENTS = st.one_of(
    st.builds(tap, st.floats(0, 900), st.floats(0, 1)),
    st.builds(
        lambda start, sizes: hum(*[(start + 37 * number, size) for number, size in enumerate(sizes)]),
        st.floats(0, 500),
        st.lists(st.floats(0, 1), min_size=2, max_size=8),
    ),
)


@given(st.lists(EVENTS, max_size=12))
def test_every_event_has_a_report_and_no_two_segments_overlap(events: list[Event]) -> None:
    made = converted(*events)
    assert [report.event for report in made.reports] == events
    for report in made.reports:
        assert report.played if report.fate in (Fate.KEPT, Fate.CHANGED) else report.notes
    clicks = [start for start, _, _, is_click in spans(made.segments) if is_click]
    assert all(later - earlier >= CLICK_MS for earlier, later in pairwise(clicks))
    assert all(s.is_click or s.duration_ns for s in made.segments)
    assert not made.segments or made.segments[-1].level_db is not None
    assert bool(made.segments) == any(report.fate in (Fate.KEPT, Fate.CHANGED) for report in made.reports)


@pytest.mark.parametrize("name", [name for name in named_effects() if name != "buzz"])
def test_a_named_effect_written_as_hjif_is_read_as_the_same_effect(name: str) -> None:
    effect = named_effects()[name]
    document = encode_hjif(effect, 25.0, 1000, "2026-01-31")
    back = decode_effect_file(Part("written", "", document), "hjif", name, 25.0)
    assert spans(back.effect.envelope) == spans(effect.envelope) and back.effect.name == name
    assert back.number(Fate.KEPT) == len(back.reports)


# What the reference reader asks for, by the member that holds it: MPEGGroup/HapticReferenceSoftware at 73ffe9bb,
# source/IOHaptics/src/IOJson.cpp, load* and semanticConformanceCheck*. It gives up at the first that is missing.
ASKED: dict[str, dict[str, Any]] = {
    "": {"version": str, "profile": str, "level": int, "date": str, "description": str, "timescale": int}
    | {"avatars": list, "perceptions": list, "syncs": list},
    "perceptions": {"id": int, "avatar_id": int, "description": str, "perception_modality": str}
    | {"effect_library": list, "channels": list},
    "reference_devices": {"id": int, "name": str},
    "channels": {"id": int, "description": str, "gain": (int, float), "mixing_coefficient": (int, float)}
    | {"body_part_mask": int, "bands": list},
    "bands": {"band_type": str, "lower_frequency_limit": int, "upper_frequency_limit": int, "effects": list},
    "effects": {"effect_type": str, "position": int, "phase": (int, float), "base_signal": str, "keyframes": list},
    "keyframes": {"relative_position": int, "amplitude_modulation": (int, float)},
    "syncs": {"timestamp": int, "timescale": int},
}


@pytest.mark.parametrize("place", [None, EffectPlace("bar", 0.04, (60.2, 299.6), 187.3)])
@pytest.mark.parametrize("effect", [*named_effects().values(), Effect("long", (Segment(119_000 * MS, 9.0),))])
def test_what_is_written_has_all_that_the_reference_reader_asks_for(effect: Effect, place: EffectPlace | None) -> None:
    document = encode_hjif(effect, 25.0, 1000, "2026-01-31", place)

    def check(part: dict[str, Any], member: str) -> None:
        for name, kind in ASKED[member].items():
            assert isinstance(part[name], kind), (member, name)
        for name, listed in part.items():
            for each in listed if isinstance(listed, list) else ():
                check(each, name)

    check(document, "")
    assert re.fullmatch(r"2\d{3}(-[1-9])?", document["version"]) and document["version"] >= "2023"
    assert re.search(r"\d{4}-[01]\d-[0-3]\d", document["date"])
    (perception,) = document["perceptions"]
    (channel,) = perception["channels"]
    assert ("reference_device_id" in channel) == bool(perception["reference_devices"]) == (place is not None)
    for device in perception["reference_devices"]:
        assert device["minimum_frequency"] <= device["resonance_frequency"] <= device["maximum_frequency"]
    for band in channel["bands"]:
        assert "curve_type" not in band and "block_length" not in band  # of curves, and of wavelets
        assert band["lower_frequency_limit"] <= band["upper_frequency_limit"]
        frames = [frame for each in band["effects"] for frame in each["keyframes"]]
        assert all(0 <= frame["relative_position"] < 1 << 15 for frame in frames)
        assert all(isinstance(frame.get("frequency_modulation", 0), int) for frame in frames)
