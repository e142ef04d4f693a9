"""Rules that decide what each finger feels, and the player that follows them."""

from engine.effects.control import ControlStep, Outcome, Role, SceneSettings, TriggeredEffect
from engine.effects.player import EffectPlayer
from engine.effects.rule_file import read_effects, read_vocabulary
from engine.effects.rules import DEFAULT_EFFECTS, Drives, Effect, EffectError, Effects, Rule, Segment, Trigger

__all__ = [
    "DEFAULT_EFFECTS",
    "ControlStep",
    "Drives",
    "Effect",
    "EffectError",
    "EffectPlayer",
    "Effects",
    "Outcome",
    "Role",
    "Rule",
    "SceneSettings",
    "Segment",
    "Trigger",
    "TriggeredEffect",
    "read_effects",
    "read_vocabulary",
]
