"""Laws of the three readers: events as the formats say, and errors that name file, place and value."""

import copy
import json
import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from engine.effects.files.ahap import read_ahap
from engine.effects.files.conversion import read_effect_file
from engine.effects.files.haptic import read_haptic
from engine.effects.files.hjif import read_hjif
from engine.effects.files.json_part import MOST_PARTS, Kind, Part
from engine.effects.rules import EffectError

SHIPPED = Path(__file__).parents[4] / "tables" / "effects"
FILES = [SHIPPED / name for name in ("knock.ahap", "drop.haptic", "pulse.hjif")]


def part(document: Any) -> Part:
    return Part("some file", "", document)


def controls(*curves: list[tuple[float, float]]) -> list[dict[str, Any]]:
    """Curves of the intensity from points with absolute times; of one point, a parameter."""
    named = {"ParameterID": "HapticIntensityControl"}
    return [
        {"Parameter": named | {"Time": curve[0][0], "ParameterValue": curve[0][1]}}
        if len(curve) == 1
        else {
            "ParameterCurve": named
            | {"Time": curve[0][0]}
            | {"ParameterCurveControlPoints": [{"Time": at - curve[0][0], "ParameterValue": v} for at, v in curve]}
        }
        for curve in curves
    ]


@pytest.mark.parametrize(
    ("curves", "expected"),
    [
        ([[(0.0, 1.0), (0.4, 0.0)], [(0.5, 1.0), (1.0, 1.0)]], {0.2: 0.5, 0.45: 0.0, 0.5: 1.0, 0.9: 1.0}),
        ([[(0.5, 1.0), (1.0, 1.0)], [(0.0, 1.0), (0.4, 0.0)]], {0.2: 0.5, 0.45: 0.0, 0.5: 1.0, 0.9: 1.0}),  # any order
        ([[(0.0, 1.0), (1.0, 0.0)], [(0.5, 0.1), (0.6, 0.1)]], {0.25: 0.75, 0.4999: 0.5, 0.55: 0.1, 0.95: 0.1}),
        ([[(0.2, 0.3)], [(0.4, 0.9)], [(0.4, 0.6)]], {0.1: 1.0, 0.3: 0.3, 0.5: 0.6}),
        ([[(at / 10, at / 10), ((at + 1) / 10, (at + 1) / 10)] for at in range(10)], {0.05: 0.05, 0.55: 0.55}),
        ([[(0.0, 0.2)], [(0.3, 0.2), (0.5, 1.0)]], {0.29: 0.2, 0.4: 0.6, 0.99: 1.0}),
    ],
)
def test_a_control_of_ahap_holds_until_the_next_one_begins(
    curves: list[list[tuple[float, float]]], expected: dict[float, float]
) -> None:
    event = {"Event": {"EventType": "HapticContinuous", "Time": 0, "EventDuration": 1.0}}
    (read,) = read_ahap(part({"Pattern": [event, *controls(*curves)]})).events
    found = np.interp(list(expected), *np.array(read.points).T)
    assert found == pytest.approx(list(expected.values()), abs=1e-3)


@pytest.mark.parametrize("text", ['{"a": [1, 2,], }', '{"a": [1, 2 \n,\n] }', '{"a": [1, 2]}'])
def test_a_comma_after_the_last_value_is_passed_over(text: str) -> None:
    assert Part.parse(text, "x").value == {"a": [1, 2]}
    kept = '{"a": ",]", "b": "\\",}"}'
    assert Part.parse(kept, "x").value == {"a": ",]", "b": '",}'}
    for wrong in ('{"a": [1,,]}', '{"a": "' + 200_000 * '\\"'):  # looked at once, or this would take hours
        with pytest.raises(EffectError):
            Part.parse(wrong, "x")


@pytest.mark.parametrize(("first_s", "points"), [(0.5, ((0.0, 0.0), (0.5, 1.0))), (0.0, None)])
def test_a_haptic_clip_rises_from_0_to_its_first_point(first_s: float, points: object) -> None:
    events = read_haptic(clip({"time": first_s, "amplitude": 1.0})).events
    assert [(event.source, event.points) for event in events] == ([("amplitude[0..0]", points)] if points else [])


@pytest.mark.parametrize(
    ("keyframes", "exponent", "points"),
    [
        ([(0, None), (500, None)], None, [(0.0, 1.0), (0.25, 1.0)]),
        ([(0, 0.8), (500, None)], None, [(0.0, 0.8), (0.25, 0.8)]),
        ([(100, 0.8), (300, 0.2), (500, None)], None, [(0.0, 0.8), (0.05, 0.8), (0.15, 0.2), (0.25, 0.2)]),
        ([(0, 1.0), (500, 1.0)], -1, [(0.0, 0.1), (0.25, 0.1)]),
        ([], None, []),
    ],
)
def test_amplitudes_of_hjif_are_held_and_1_where_none_is_given(
    keyframes: list[tuple[int, float | None]], exponent: int | None, points: list[tuple[float, float]]
) -> None:
    listed = [{"relative_position": at, "amplitude_modulation": size} for at, size in keyframes]
    made = hjif("VectorialWave", {"position": 0, "keyframes": listed})
    made["perceptions"][0]["channels"][0]["gain"] = 1.0
    if exponent is not None:
        made["perceptions"][0]["perception_unit_exponent"] = exponent
    (event,) = read_hjif(part(made)).events
    if points:
        assert np.array(event.points) == pytest.approx(np.array(points))
    else:
        assert event.kind is Kind.OTHER and "no keyframe" in event.reason


def test_ahap_clips_has_defaults_and_names_what_it_cannot_play() -> None:
    sound = {"EventType": "AudioCustom", "Time": 0.5}
    loud = {
        "EventType": "HapticTransient",
        "EventParameters": [
            {"ParameterID": "HapticIntensity", "ParameterValue": 7},
            {"ParameterID": "HapticSharpness", "ParameterValue": 0.4},
            {"ParameterID": "DecayTime", "ParameterValue": 0.2},
        ],
    }
    bare = {"EventType": "HapticTransient", "Time": 1}
    dynamic = {"Parameter": {"ParameterID": "HapticSharpnessControl", "Time": 0, "ParameterValue": 0.1}}
    events = read_ahap(part({"Pattern": [{"Event": each} for each in (sound, loud, bare)] + [dynamic]})).events
    assert [event.kind for event in events] == [Kind.OTHER, Kind.TRANSIENT, Kind.TRANSIENT, Kind.OTHER]
    reasons = (events[0].reason, events[3].reason)
    assert reasons == ("AudioCustom is no vibration", "HapticSharpnessControl is not kept")
    assert events[1].points == ((0.0, 1.0),) and events[1].unused == ("sharpness 0.4", "DecayTime 0.2")
    assert events[2].points == ((1.0, 1.0),)


def clip(*amplitude: dict[str, Any]) -> Part:
    signals = {"continuous": {"envelopes": {"amplitude": list(amplitude)}}}
    return part({"version": {"major": 1}, "signals": signals})


def test_a_clip_has_its_emphases_and_its_stretches_above_0() -> None:
    emphasis = {"amplitude": 0.9, "frequency": 0.7}
    levels = [(0, 0.0), (0.1, 0.2), (0.2, 0.0), (0.3, 0.0), (0.4, 0.0), (0.5, 0.5), (0.6, 0.0), (0.7, 0.6)]
    points: list[dict[str, Any]] = [{"time": at, "amplitude": size} for at, size in levels]
    points[3]["emphasis"] = emphasis
    events = read_haptic(clip(*points)).events
    assert [(event.source, event.kind) for event in events] == [
        ("amplitude[3].emphasis", Kind.TRANSIENT),
        ("amplitude[0..2]", Kind.CONTINUOUS),
        ("amplitude[4..6]", Kind.CONTINUOUS),
        ("amplitude[6..7]", Kind.CONTINUOUS),
    ]
    assert events[0].points == ((0.3, 0.9),) and events[0].unused == ("frequency 0.7 of 1",)
    assert events[1].points == ((0.0, 0.0), (0.1, 0.2), (0.2, 0.0))


def hjif(band_type: str, *effects: dict[str, Any], library: list[dict[str, Any]] | None = None) -> dict[str, Any]:
    band = {"band_type": band_type, "effects": list(effects)}
    channel = {"id": 0, "description": "Left hand", "gain": 0.5, "body_part_mask": 2, "bands": [band]}
    perception = {"perception_modality": "Vibrotactile", "effect_library": library or [], "channels": [channel]}
    return {"timescale": 2000, "description": "made", "perceptions": [perception]}


def keyframe(at: int, size: float, **more: float) -> dict[str, float]:
    return {"relative_position": at, "amplitude_modulation": size, **more}


def test_hjif_keyframes_of_transients_are_one_event_each_with_the_gain_of_the_channel() -> None:
    effect = {"position": 100, "keyframes": [keyframe(0, 1.0, frequency_modulation=90), keyframe(50, -0.5)]}
    events = read_hjif(part(hjif("Transient", effect))).events
    assert [event.points for event in events] == [((0.05, 0.5),), ((0.075, 0.25),)]
    assert events[0].unused == ("frequency 90 Hz", "place Left hand, body parts 0x2")
    assert events[1].source.endswith("keyframes[1]")


def test_hjif_references_stand_for_effects_of_the_library_and_positions_before_0_for_the_start() -> None:
    kept = {"id": 4, "position": 7, "keyframes": [keyframe(65534, 1.0), keyframe(0, 0.0), keyframe(200, 0.8)]}
    asked = [{"effect_type": "Reference", "id": 4, "position": at} for at in (0, 400)]
    events = read_hjif(part(hjif("VectorialWave", *asked, library=[kept]))).events
    assert events[0].points == ((0.0, 0.5), (0.0, 0.0), (0.1, 0.4))
    assert events[1].points == ((0.199, 0.5), (0.2, 0.0), (0.3, 0.4))


def test_hjif_composite_effects_are_read_and_those_that_contain_themselves_refused() -> None:
    inner = {"position": 20, "keyframes": [keyframe(0, 1.0), keyframe(20, 1.0)]}
    composite = {"effect_type": "Composite", "position": 40, "composition": [inner]}
    (event,) = read_hjif(part(hjif("Curve", composite))).events
    assert (event.start_s, event.stop_s) == (0.03, 0.04) and "the signal's own course" in event.unused
    circle = {"effect_type": "Reference", "id": 1, "position": 0}
    with pytest.raises(EffectError, match="none that refers to itself"):
        read_hjif(part(hjif("Curve", circle, library=[circle])))


@pytest.mark.parametrize(
    ("band_type", "leaf"),
    [
        ("VectorialWave", {"keyframes": []}),  # it makes no event, and its visits take time all the same
        ("Transient", {"keyframes": [keyframe(0, 1.0)]}),
        ("VectorialWave", {"keyframes": [keyframe(0, 1.0), keyframe(1, 1.0)]}),
    ],
)
def test_hjif_references_within_references_are_refused_before_all_expand(band_type: str, leaf: dict[str, Any]) -> None:
    """Five kB that stand for 10 000 effects and more, and at 16 kB for millions."""
    references = [[{"effect_type": "Reference", "id": number}] * 22 for number in range(3)]
    composites = [{"id": k, "effect_type": "Composite", "composition": each} for k, each in enumerate(references, 1)]
    made = hjif(band_type, {"effect_type": "Reference", "id": 3}, library=[{"id": 0, **leaf}, *composites])
    with pytest.raises(EffectError, match=rf"composition.*: expected at most {MOST_PARTS} events"):
        read_hjif(part(made))


def test_ahap_events_under_curves_are_refused_before_all_their_points_are_made() -> None:
    """Each event has the points of all curves: the number of both is linear in a file, and their product is not."""
    points = [{"Time": 0.1 * at, "ParameterValue": 1.0} for at in range(120)]
    curve = {"ParameterCurve": {"ParameterID": "HapticIntensityControl", "ParameterCurveControlPoints": points}}
    event = {"Event": {"EventType": "HapticContinuous", "EventDuration": 12}}
    assert len(read_ahap(part({"Pattern": [curve, *[event] * 80]})).events) == 80
    with pytest.raises(EffectError, match=rf"expected at most {MOST_PARTS} events"):
        read_ahap(part({"Pattern": [curve, *[event] * 90]}))


def test_a_word_that_reports_repeat_for_each_event_is_short() -> None:
    document = hjif("Transient", *[{"keyframes": [keyframe(0, 1.0)]}] * 100)
    document["perceptions"][0]["channels"][0]["description"] = "left " * 1000
    assert all(len(note) < 100 for event in read_hjif(part(document)).events for note in event.unused)
    document["perceptions"][0]["perception_modality"] = "Force" * 1000
    with pytest.raises(EffectError, match=r"perception_modality: .*at most 64 characters"):
        read_hjif(part(document))


@pytest.mark.parametrize(
    ("modality", "band_type", "reason"),
    [
        ("Force", "VectorialWave", "Force is no vibration"),
        ("Vibrotactile", "WaveletWave", "a band of WaveletWave holds coded samples"),
    ],
)
def test_hjif_that_is_no_course_of_vibration_is_named(modality: str, band_type: str, reason: str) -> None:
    document = hjif(band_type, {"position": 0, "keyframes": []})
    document["perceptions"][0]["perception_modality"] = modality
    (event,) = read_hjif(part(document)).events
    assert event.kind is Kind.OTHER and event.reason == reason


@pytest.mark.parametrize(
    ("name", "text", "expected"),
    [
        ("a.ahap", "{", r"a.ahap: not JSON"),
        ("a.ahap", "[" * 100_000, r"a.ahap: not JSON"),
        ("a.ahap", '{"Pattern": NaN}', r"NaN is no number of JSON"),
        ("a.ahap", "[]", r"a.ahap: document: \[\]: expected an object"),
        ("a.ahap", '{"Pattern": [{"Event": {"EventType": "HapticTransient", "Time": -1}}]}', r"Event.Time: -1: "),
        ("a.ahap", '{"Pattern": [{"Event": {"EventType": "HapticTransient", "Time": 1e9}}]}', r"expected 0 to 120 s"),
        ("a.ahap", '{"Pattern": [{"Event": {"EventType": 7}}]}', r"EventType: 7: expected a text"),
        ("a.haptic", '{"version": {"major": 2}}', r"version.major: 2: expected 1"),
        ("a.haptic", '{"version": {"major": 1}}', r"expected an object with the key 'signals'"),
        ("a.hjif", '{"timescale": 0, "perceptions": []}', r"timescale: 0: expected 1 to"),
        ("a.hjif", '{"perceptions": [{"channels": [{"bands": 3}]}]}', r"bands: 3: expected a list"),
        ("a.wav", "", r"a.wav: ends in '.wav'; expected .ahap, .haptic, .hjif"),
    ],
)
def test_what_is_wrong_is_refused_by_file_place_and_value(tmp_path: Path, name: str, text: str, expected: str) -> None:
    (tmp_path / name).write_text(text, encoding="utf-8")
    with pytest.raises(EffectError, match=expected):
        _ = read_effect_file(tmp_path / name, "x").effect


def test_times_of_a_clip_rise() -> None:
    with pytest.raises(EffectError, match=r"amplitude\[1\].time: 0.1: expected no time before the last point's"):
        read_haptic(clip({"time": 0.2, "amplitude": 1}, {"time": 0.1, "amplitude": 1}))


def edited(values: Any, random_: random.Random) -> Any:
    """The document with one value somewhere replaced or removed."""
    values = copy.deepcopy(values)
    inner = values
    while True:
        keys = list(inner) if isinstance(inner, dict) else list(range(len(inner)))
        if not keys:
            return values
        key = random_.choice(keys)
        if not isinstance(inner[key], dict | list) or not inner[key] or random_.random() < 0.1:
            odd: tuple[Any, ...] = (
                None, -1, 1e300, 1e-300, "", "x", [], {}, [[]], True, [{}], 10**400, 65535, "Reference",
            )  # fmt: skip
            inner[key] = copy.deepcopy(random_.choice(odd))
            return values
        inner = inner[key]


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_edited_files_are_read_or_refused_in_words(path: Path, tmp_path: Path) -> None:
    whole, random_, refused = json.loads(path.read_text(encoding="utf-8")), random.Random(5), 0
    assert read_effect_file(path, path.stem).effect.envelope
    for _ in range(400):
        document = edited(whole, random_)
        if random_.random() < 0.3:
            document = edited(document, random_)
        case = tmp_path / path.name
        case.write_text(json.dumps(document), encoding="utf-8")
        try:
            made = read_effect_file(case, "case")
        except EffectError as error:
            refused += 1
            assert 0 < len(str(error)) < 600
        else:
            assert all(segment.is_click or (segment.duration_ns or 0) > 0 for segment in made.segments)
    assert refused > 20
