"""Rules that decide what each finger feels, and the player that follows them."""

from engine.effects.player import EffectPlayer
from engine.effects.rule_file import read_effects, read_vocabulary
from engine.effects.rules import DEFAULT_EFFECTS, Effect, EffectError, Effects, Rule, Segment, Trigger

__all__ = [
    "DEFAULT_EFFECTS",
    "Effect",
    "EffectError",
    "EffectPlayer",
    "Effects",
    "Rule",
    "Segment",
    "Trigger",
    "read_effects",
    "read_vocabulary",
]
