"""Laws of rules and their files: what they say is what is read, and errors name key, value and expectation."""

import re
from pathlib import Path

import pytest

from engine.device import Device
from engine.effects.rule_file import parse_effects, read_vocabulary
from engine.effects.rules import (
    DEFAULT_EFFECTS,
    FULL_SCALE_DB,
    Drives,
    Effect,
    EffectError,
    Effects,
    Rule,
    Segment,
    Trigger,
    burst,
)
from engine.touch import Touch

TABLES = Path(__file__).parents[3] / "tables"
DEVICE = Device.read(TABLES / "devices" / "reference-a.toml")
SHIPPED = sorted((TABLES / "effects").glob("*.toml"))
NAMED = read_vocabulary(TABLES / "vocabulary.toml")
EXAMPLES = re.findall(r"```toml\n(.*?)```", (TABLES / "EFFECTS.md").read_text(encoding="utf-8"), re.DOTALL)
MS = 1_000_000

WHOLE = """
[[effect]]
name = "tick"
envelope = [["20 ms", "full scale"], ["10 ms", "quiet"], ["0.02 s", "12.5 dB"]]

[[effect]]
name = "purr"
envelope = [["held", "10 dB"]]

[[rule]]
on = "touch"
zones = ["I", "III"]
effect = "tick"

[[rule]]
on = "hold"
after = "500 ms"
region = ["50 mm", "50 %"]
effect = "purr"

[[rule]]
on = "drag"
every = "1 cm"
effect = "purr"

[[rule]]
on = "lift"
effect = "tick"
"""
TICK = Effect("tick", (Segment(20 * MS, FULL_SCALE_DB), Segment(10 * MS, None), Segment(20 * MS, 12.5)))
PURR = Effect("purr", (Segment(None, 10.0),))


def refusal(text: str) -> str:
    with pytest.raises(EffectError) as error:
        parse_effects(text, "some.toml", DEVICE)
    message = str(error.value)
    assert message.startswith("some.toml: ")
    return message


def test_a_file_is_read_as_it_is_written() -> None:
    assert parse_effects(WHOLE, "some.toml", DEVICE) == Effects(
        (
            Rule(Trigger.TOUCH, TICK, zones=frozenset({0, 2})),
            Rule(Trigger.HOLD, PURR, region_m=(0.05, 0.1397), after_ns=500 * MS),
            Rule(Trigger.DRAG, PURR, every_m=0.01),
            Rule(Trigger.LIFT, TICK),
        )
    )


def test_a_file_says_where_its_drives_come_from() -> None:
    assert parse_effects(WHOLE, "some.toml", DEVICE).drives is Drives.POSITIONS
    of_zones = parse_effects('drives = "zones"\n' + WHOLE, "some.toml", DEVICE)
    assert of_zones.drives is Drives.ZONES and not of_zones.have_clicks
    with pytest.raises(EffectError, match=r"drives: 'zone': expected one of positions, zones"):
        parse_effects('drives = "zone"\n' + WHOLE, "some.toml", DEVICE)


@pytest.mark.parametrize("text", [*(path.read_text(encoding="utf-8") for path in SHIPPED), *EXAMPLES])
def test_a_shipped_file_and_an_example_of_the_document_is_read(text: str) -> None:
    assert parse_effects(text, "EFFECTS.md", DEVICE, NAMED).rules


def test_the_first_example_of_the_document_is_what_goes_without_a_file() -> None:
    assert parse_effects(EXAMPLES[0], "EFFECTS.md", DEVICE) == DEFAULT_EFFECTS


def test_the_vocabulary_has_the_words_of_hid_and_the_web_each_in_the_document_and_no_rules(tmp_path: Path) -> None:
    words = "click press release tick edge align hover buzz rumble success error"
    assert " ".join(NAMED) == words
    table = (TABLES / "EFFECTS.md").read_text(encoding="utf-8").partition("## Named effects")[2].partition("```")[0]
    assert set(re.findall(r"`(\w+)`", table)) >= set(NAMED)
    assert len({effect.envelope for effect in NAMED.values()}) == len(NAMED)
    for effect in NAMED.values():  # two clicks do not melt into one
        for before, pause, after in zip(effect.envelope, effect.envelope[1:], effect.envelope[2:], strict=False):
            if before.is_click and after.is_click:
                assert pause.level_db is None and pause.duration_ns is not None and pause.duration_ns > 30 * MS
    (tmp_path / "words.toml").write_text(WHOLE, encoding="utf-8")
    with pytest.raises(EffectError, match=r"rule: .*unknown key"):
        read_vocabulary(tmp_path / "words.toml")


def test_a_rule_names_an_effect_of_the_vocabulary_and_the_file_may_replace_it() -> None:
    rule = '[[rule]]\non = "touch"\neffect = "press"\n'
    assert parse_effects(rule, "some.toml", DEVICE, NAMED) == Effects((Rule(Trigger.TOUCH, NAMED["press"]),))
    own = '[[effect]]\nname = "press"\nenvelope = [["20 ms", "12 dB"]]\n'
    (replaced,) = parse_effects(own + rule, "some.toml", DEVICE, NAMED).rules
    assert replaced.effect == Effect("press", (Segment(20 * MS, 12.0),))
    with pytest.raises(EffectError, match=r"rule\[1\].effect: 'pres': expected one of click, press"):
        parse_effects(rule.replace("press", "pres"), "some.toml", DEVICE, NAMED)
    with pytest.raises(EffectError, match="holds nothing"):
        parse_effects(rule.replace("touch", "lift").replace("press", "buzz"), "some.toml", DEVICE, NAMED)


# (what is written, what is put in its place, what the message says)
WRONG = [
    ('name = "tick"', 'name = "purr"', "effect[2].name: 'purr': another effect has this name"),
    ('name = "tick"', 'name = "tick"\nvolume = 3', "effect[1].volume: 3: unknown key; known keys are name, envelope"),
    ('[["held", "10 dB"]]', "[]", "effect[2].envelope: []: expected a list of segments"),
    ('[["held", "10 dB"]]', '["held", "10 dB"]', "effect[2].envelope: 'held': expected a duration and a level"),
    ('[["held", "10 dB"]]', '[["held", "10 dB"], ["5 ms", "10 dB"]]', "only the last segment may be 'held'"),
    ('["held", "10 dB"]', '["0 ms", "10 dB"]', "effect[2].envelope: '0 ms': expected at least 0.001 s"),
    ('["held", "10 dB"]', '["held", "81 dB"]', "effect[2].envelope: '81 dB': expected 0 to 80 dB above threshold"),
    ('["held", "10 dB"]', '["held", "loud"]', "'loud': expected 0 to 80 dB above threshold such as '20 dB', 'full sc"),
    ('on = "touch"', 'on = "tap"', "rule[1].on: 'tap': expected one of touch, hold, lift, drag"),
    ('zones = ["I", "III"]', 'zones = ["VI"]', "rule[1].zones: 'VI': reference-a has no such zone; its zones are I"),
    ('zones = ["I", "III"]', "zones = []", "rule[1].zones: []: expected a list of zones"),
    ('zones = ["I", "III"]', 'zones = ["I"]\nregion = ["0 mm", "1 mm"]', "give either zones or a region"),
    ('zones = ["I", "III"]', 'after = "1 s"', "rule[1].after: '1 s': unknown key"),
    ('["50 mm", "50 %"]', '["50 %", "50 mm"]', "rule[2].region: ['50 %', '50 mm']: is empty"),
    ('["50 mm", "50 %"]', '["50 mm"]', "rule[2].region: ['50 mm']: expected two positions"),
    ('["50 mm", "50 %"]', '["50 mm", "101 %"]', "rule[2].region: '101 %': is off the bar, which is 279.4 mm long"),
    ('after = "500 ms"', "", "[rule[2]] has no key 'after'"),
    ('after = "500 ms"', 'after = "0 s"', "rule[2].after: '0 s': expected at least 0.001 s"),
    ('every = "1 cm"', 'every = "1 um"', "rule[3].every: '1 um': expected at least 0.0001 m"),
    ('on = "lift"\neffect = "tick"', 'on = "lift"\neffect = "purr"', "rule[4].effect: 'purr': its envelope ends with"),
    ("[[effect]]", "[[effects]]", "unknown key; did you mean 'effect'?"),
    ("[[effect]]", "[[effect", "not TOML"),
]


@pytest.mark.parametrize(("written", "wrong", "expected"), WRONG, ids=[f"{w} -> {x}" for w, x, _ in WRONG])
def test_what_is_wrong_is_refused_by_key_value_and_expectation(written: str, wrong: str, expected: str) -> None:
    text = WHOLE.replace(written, wrong)
    assert text != WHOLE
    assert expected in refusal(text)


def test_more_rules_or_segments_than_a_loop_looks_through_are_refused() -> None:
    rule = WHOLE[WHOLE.rindex("[[rule]]") :]
    assert "rule: 260: expected at most 256 rules" in refusal(WHOLE + 256 * rule)
    assert "effect[2].envelope: 1025: expected at most 1024 segments" in refusal(
        WHOLE.replace('["held", "10 dB"]', ", ".join(['["1 ms", "10 dB"]'] * 1025))
    )


def test_by_default_every_touch_feels_a_click_at_20_db() -> None:
    (rule,) = DEFAULT_EFFECTS.rules
    assert rule.on is Trigger.TOUCH
    assert rule.effect.envelope == (Segment(None, 20.0, is_click=True),)
    assert DEFAULT_EFFECTS.have_clicks and not Effects((Rule(Trigger.TOUCH, burst(20.0, 1)),)).have_clicks
    assert rule.covers(Touch(1, 0.1, 2)) and rule.covers(Touch(1, 0.1, None))
    assert DEFAULT_EFFECTS.levels_db == (20.0,)


def test_the_levels_are_those_of_all_rules_rising_and_without_pauses() -> None:
    loud = Effect("loud", (Segment(MS, FULL_SCALE_DB), Segment(MS, None), Segment(None, 5.0)))
    effects = Effects((Rule(Trigger.TOUCH, loud), Rule(Trigger.LIFT, burst(20.0, 1)), Rule(Trigger.HOLD, loud)))
    assert effects.levels_db == (5.0, 20.0, FULL_SCALE_DB)
