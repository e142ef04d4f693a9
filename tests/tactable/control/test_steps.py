"""Laws of the scene of programs, and of the stated form of its steps: parts of bounded size are read as written."""

import json
import math
import random
from collections import Counter
from typing import Any

import pytest

from engine.effects.effect_player import EffectPlayer
from engine.effects.files.conversion import MOST_SEGMENTS as MOST_OF_AN_EFFECT
from engine.effects.rules import (
    ControlStep,
    Effect,
    Effects,
    Role,
    Rule,
    SceneSettings,
    Segment,
    Trigger,
    TriggeredEffect,
    click,
)
from engine.touch import Touch
from tactable.control.requests import MOST_DEFINED, MOST_REGIONS, MOST_RULES, ControlError, Region, Scene
from tactable.control.steps import MOST_BYTES, MOST_SEGMENTS, StepDecoder, StepEncoder, StepError
from tactable.shipped import named_effects

ODD = Effect("ödd", (Segment(5, None), Segment(7, math.inf), Segment(None, 20.25, is_click=True), Segment(None, 1 / 3)))
LONGEST_NAME = "\U0001f600" * 64
PLACES: list[tuple[frozenset[int] | None, tuple[float, float] | None]] = [
    (frozenset({0, 3}), None),
    (None, (1 / 3, 2 / 3)),
]


def large(number: int) -> Effect:
    """An effect of the allowed size whose numbers are as long as numbers get."""
    segments = [Segment(10**15 + at, 60 + at / 7e7, is_click=False) for at in range(MOST_OF_AN_EFFECT)]
    return Effect(f"{number}{LONGEST_NAME}"[:64], tuple(segments))


def region_of(number: int, *effects: Effect, zones: bool = False, **more: object) -> Region:
    rules = [Rule(on, effect, every_m=1 / 3) for on, effect in zip(2 * tuple(Trigger), effects, strict=False)]
    place = (frozenset(range(16)), None) if zones else (None, (number / 1001, number / 999))
    values: dict[str, object] = {"is_enabled": True, "level_change_db": -1 / 3, "stays": False, **more}
    return Region(f"r{number}", tuple(rules), *place, **values)  # type: ignore[arg-type]  # its fields


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("is_enabled", [True, False])
def test_what_is_written_is_read_and_what_is_no_number_is_not_written(
    place: tuple[frozenset[int] | None, tuple[float, float] | None], is_enabled: bool
) -> None:
    scene, encoder, decoder = Scene(named_effects()), StepEncoder(), StepDecoder()
    with pytest.raises(ValueError, match="not JSON compliant"):
        [*StepEncoder().parts(scene, ControlStep(trigger=TriggeredEffect(ODD, 7, None, math.nan)))]
    asked = [
        Rule(Trigger.HOLD, ODD, after_ns=10**9),
        Rule(Trigger.DRAG, large(1), every_m=0.005),
        Rule(Trigger.DRAG, ODD, every_m=1),
    ]
    scene.set_region(Region("a", tuple(asked), *place, is_enabled, -1 / 3, False), 1)
    scene.set_settings(1, SceneSettings(False, True, 1 / 3))
    role, trigger = Role(1 << 52, True, 9), TriggeredEffect(ODD, 7, None, 1 / 3, -0.5)
    asked_beside = ControlStep(stopped_owner=4, gone_owner=5, role=role, trigger=trigger)
    steps = [decoder.decode(part) for part in encoder.parts(scene, asked_beside)]
    scene_step, act = [step for step in steps if step is not None]
    assert scene_step == decoder.scene and scene_step.settings == SceneSettings(False, True, 1 / 3)
    assert (act.stopped_owner, act.gone_owner, act.role, act.trigger) == (4, 5, role, trigger)
    assert (act.rules, act.settings, scene_step.trigger) == (None, None, None)
    own = asked if is_enabled else []
    expected = [Rule(each.on, each.effect, *place, each.after_ns, each.every_m, -1 / 3) for each in own]
    rules = [*(scene_step.rules or ())]
    assert rules[: len(own)] == expected
    others = {
        rule.on for rule in rules[len(own) :] if (rule.zones, rule.region_m) == place and not rule.effect.envelope
    }
    assert others == set(Trigger) - {rule.on for rule in own} and len(rules) == len(own) + len(others)


def test_a_step_is_bounded_whatever_programs_hold_and_only_what_changed_crosses() -> None:
    scene, encoder, decoder = Scene(named_effects()), StepEncoder(), StepDecoder()
    kinds = Counter[str]()

    def hand_over(**more: Any) -> list[str]:
        """The kinds of the parts that bring the loop up to the scene."""
        found = []
        for part in encoder.parts(scene, ControlStep(**more)):
            document = json.loads(part)
            assert len(part) <= MOST_BYTES and len(document.get("segments", ())) <= MOST_SEGMENTS
            assert len(document.get("rules", ())) <= MOST_RULES
            found.append(next(iter(document)))
            decoder.decode(part)
        kinds.update(found)
        return found

    effects = [large(number) for number in range(MOST_DEFINED)]
    for effect in effects:
        scene.define(effect, 1)
    assert hand_over() == []
    for number in range(MOST_REGIONS - 1):
        mine = [effects[(3 * number + at) % MOST_DEFINED] for at in range(MOST_RULES)]
        scene.set_region(region_of(number, *mine, zones=number % 2 == 0), 1)
        hand_over()
    assert kinds["effect"] == MOST_DEFINED * MOST_OF_AN_EFFECT / MOST_SEGMENTS  # each of them once
    scene.set_region(region_of(MOST_REGIONS, *effects[:MOST_RULES]), 1)
    assert hand_over() == ["region", "scene"]
    scene.set_region(region_of(MOST_REGIONS, *effects[:MOST_RULES], is_enabled=False), 1)
    assert hand_over() == ["region", "scene"]
    scene.set_settings(1, SceneSettings(level_change_db=1 / 3))
    assert hand_over() == ["scene"] and hand_over() == [] and hand_over(stopped_owner=1) == ["act"]
    scene.define(large(0), 2)
    scene.set_region(region_of(0, ODD), 2)
    assert hand_over() == ["effect", "region", "scene"]  # the region 1 names the first effect 0 no more, another does
    scene.end_lease(1)
    scene.end_lease(2)
    ended = hand_over(gone_owner=1)
    assert ended[:2] == ["scene", "act"] and set(ended[2:]) == {"forget"}
    assert kinds["forget"] == MOST_DEFINED + 1 and decoder.scene.rules == ()


def test_a_scene_may_change_without_an_end() -> None:
    """Numbers of what is no longer held are given again."""
    scene, encoder, decoder = Scene(named_effects()), StepEncoder(), StepDecoder()
    for number in range(1100):
        scene.set_region(region_of(0, Effect("e", (Segment(number, 20.0),))), 1)
        for part in encoder.parts(scene):
            decoder.decode(part)
        assert (decoder.scene.rules or ())[0].effect.envelope[0].duration_ns == number


EFFECT: dict[str, Any] = {"effect": 1, "name": "e", "at": 0, "segments": [[5, 20.0, False]], "is_whole": True}
REGION: dict[str, Any] = {
    "region": 0,
    "rules": [["touch", 1, 0, 0.0]],
    "zones": None,
    "region_m": [0.0, 0.1],
    "level_change_db": 0.0,
}
SCENE: dict[str, Any] = {"scene": [0], "settings": [True, True, 0.0]}
ACT: dict[str, Any] = {"act": {"stopped": None, "gone": 1, "role": [3, True, 1], "trigger": [1, 1, 3, None, 0.0]}}
WRONG = [
    {},
    {"other": 1},
    EFFECT | {"more": 1},
    *(EFFECT | {"effect": number} for number in (-1, True, 1024)),
    EFFECT | {"name": 3},
    *(EFFECT | {"at": 1, "effect": number} for number in (1, 2)),
    *(EFFECT | {"segments": [segment]} for segment in ([5, 20.0], [5.5, 20.0, False], [5, "x", False], [5, 20.0, 1])),
    *(EFFECT | {"segments": segments} for segments in (3, [[1, None, False]] * (MOST_SEGMENTS + 1))),
    REGION | {"region": 1024},
    *(REGION | {"rules": [rule]} for rule in (["tap", 1, 0, 0.0], ["touch", 2, 0, 0.0], ["touch", 1, 1.5, 0.0])),
    REGION | {"rules": [["touch", 1, 0, None]]},
    REGION | {"zones": [1.5]},
    *(REGION | {"region_m": region_m} for region_m in ([0.0], ["0", "1"])),
    REGION | {"level_change_db": None},
    SCENE | {"scene": [3]},
    *(SCENE | {"settings": each} for each in ([1, True, 0.0], [True, 0, 0.0], [True, True], [True, True, "0"])),
    {"act": {}},
    {"act": None},
    *({"act": ACT["act"] | wrong} for wrong in ({"gone": -1}, {"stopped": "1"})),
    *({"act": ACT["act"] | {"role": role}} for role in ([3, 1, 1], [3.5, True, 1])),
    {"act": ACT["act"] | {"trigger": [2, 1, 3, None, 0.0]}},
    *({"act": ACT["act"] | {"trigger": [1, 1, *place, 0.0]}} for place in ((None, None), (3, 0.1))),
    {"act": ACT["act"] | {"trigger": [1, 1, 3, None, None]}},
    {"forget": 7},
]


def decoded() -> StepDecoder:
    decoder = StepDecoder()
    for document in (EFFECT, REGION, SCENE, ACT):
        decoder.decode(json.dumps(document).encode())
    return decoder


@pytest.mark.parametrize("document", WRONG, ids=str)
def test_what_does_not_have_the_form_is_refused_and_changes_no_scene(document: object) -> None:
    decoder = decoded()
    before = decoder.scene
    with pytest.raises(StepError):
        decoder.decode(json.dumps(document).encode())
    assert decoder.scene is before


def test_what_is_no_part_is_refused_and_other_bytes_are_read_or_refused() -> None:
    for part in (b"", b"\xff", b"[1]", b"3", b'{"scene": NaN}', b" " * MOST_BYTES + b"{}"):
        with pytest.raises(StepError):
            decoded().decode(part)
    random_, refused = random.Random(3), 0
    for _ in range(2000):
        edited = bytearray(json.dumps(random_.choice((EFFECT, REGION, SCENE, ACT))).encode())
        edited[random_.randrange(len(edited))] = random_.randrange(256)
        try:
            decoded().decode(bytes(edited))
        except StepError:
            refused += 1
    assert 1000 < refused < 2000


NAMED = named_effects()
BASE = Effects((Rule(Trigger.TOUCH, click(20.0)), Rule(Trigger.LIFT, click(15.0))), tuple(NAMED.values()))


def region(name: str, start_mm: float, stop_mm: float, effect: str = "press", **more: object) -> Region:
    region_m = (1e-3 * start_mm, 1e-3 * stop_mm)
    rule = Rule(Trigger.TOUCH, NAMED[effect])
    values: dict[str, object] = {"is_enabled": True, "level_change_db": 0.0, "stays": False, **more}
    return Region(name, (rule,), None, region_m, **values)  # type: ignore[arg-type]  # its fields


def felt_at(scene: Scene, place_mm: float, on: Trigger = Trigger.TOUCH) -> float | None:
    """Level that a finger feels in a run whose loop was brought up to the scene; None where it feels nothing."""
    decoder, player = StepDecoder(), EffectPlayer(BASE)
    for part in StepEncoder().parts(scene):
        decoder.decode(part)
    player.control(decoder.scene, 0)
    player.take_touches([Touch(1, 1e-3 * place_mm, 0)], 0)
    if on is Trigger.LIFT:
        player.advance_effects(10**9)
        player.take_touches([], 2 * 10**9)
    return player.wanted.level_db


def test_a_region_takes_the_place_of_what_lies_below_it_for_every_event() -> None:
    scene = Scene(NAMED)
    scene.set_region(region("low", 0, 100), 1)
    scene.set_region(region("top", 50, 150, "tick"), 2)
    assert [felt_at(scene, at) for at in (20, 70, 120, 200)] == [25.0, 10.0, 10.0, 20.0]
    assert [felt_at(scene, at, Trigger.LIFT) for at in (20, 200)] == [None, 15.0]
    assert [scene.top_region_at(1e-3 * at, None) for at in (20, 70, 150, 150.001)] == ["low", "top", "top", None]
    scene.set_region(region("low", 0, 100, "release"), 1)
    assert [felt_at(scene, at) for at in (20, 70)] == [15.0, 10.0]


def test_what_a_program_holds_ends_with_its_lease_and_a_region_that_is_off_is_silent() -> None:
    scene = Scene(NAMED)
    scene.set_region(region("mine", 0, 50), 1)
    scene.set_region(region("taken over", 50, 100), 1)
    scene.set_region(region("taken over", 50, 100), 2)
    scene.set_region(region("stays", 100, 150, stays=True, level_change_db=-10.0), 1)
    scene.set_region(region("off", 20, 50, is_enabled=False, stays=True), 1)
    scene.set_settings(1, SceneSettings(uses_rule_file=False, level_change_db=-5.0))
    assert [felt_at(scene, at) for at in (10, 20, 70, 120, 200)] == [20.0, None, 20.0, 10.0, None]
    scene.end_lease(1)
    assert [felt_at(scene, at) for at in (10, 20, 70, 120, 200)] == [20.0, None, 25.0, 15.0, 20.0]
    assert scene.settings == SceneSettings()


def test_effects_end_with_the_program_that_defined_them_and_regions_keep_theirs() -> None:
    scene = Scene(NAMED)
    for name, owner in (("mine", 1), ("taken over", 1), ("taken over", 2)):
        scene.define(Effect(name, NAMED["tick"].envelope), owner)
    rule = Rule(Trigger.TOUCH, scene.effects["mine"])
    scene.set_region(Region("kept", (rule,), None, (0.0, 0.1), True, 0.0, True), 1)
    scene.end_lease(1)
    assert set(scene.effects) - set(NAMED) == {"taken over"}
    assert felt_at(scene, 50) == 10.0
    for number in range(63):
        scene.define(Effect(f"e{number}", NAMED["press"].envelope), 3)
    scene.end_lease(3)
    scene.define(Effect("room again", NAMED["press"].envelope), 2)


def test_a_scene_has_bounds() -> None:
    scene = Scene(NAMED)
    for number in range(32):
        scene.set_region(region(f"r{number}", 0, 50), 1)
    scene.set_region(region("r3", 10, 50), 1)
    with pytest.raises(ControlError, match="remove one first"):
        scene.set_region(region("one more", 0, 50), 1)
    with pytest.raises(ControlError, match=r"'x'.*one of: r0, r1, "):
        scene.remove_region("x")
    with pytest.raises(ControlError, match=r"'x'.*there is none"):
        Scene(NAMED).remove_region("x")
    for number in range(64):
        scene.define(Effect(f"e{number}", NAMED["press"].envelope), 1)
    with pytest.raises(ControlError, match="define one anew"):
        scene.define(Effect("one more", NAMED["press"].envelope), 1)
    with pytest.raises(ControlError, match="choose another name"):
        scene.define(NAMED["press"], 1)
