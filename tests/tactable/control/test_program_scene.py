"""Laws of the scene: which rule a finger meets, and what ends with a program."""

import pytest

from engine.effects.effect_player import EffectPlayer
from engine.effects.rules import Effect, Effects, Rule, SceneSettings, Trigger, click
from engine.touch import Touch
from tactable.control.program_scene import Scene
from tactable.control.requests import ControlError, Region
from tactable.control.steps import StepDecoder, StepEncoder
from tactable.shipped import named_effects

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
