"""The switches of the page, and the rules they come to."""

import math
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from base.plain import to_plain
from engine.effects.rules import Drives, Trigger
from tactable.page.choices import Choice, ChoiceError, Offered, Rules, Source, changed, effects_of, offered
from tactable.shipped import find_device, shipped_names

DEVICE = find_device("reference-a")
ZONES = tuple(zone.name for zone in DEVICE.zones)
OFFERS = offered("reference-a")
CHOICES = st.builds(
    Choice,
    device=st.sampled_from(shipped_names()),
    source=st.sampled_from([Source.CLICK, Source.STEADY, Source.ZONES]),
    rules=st.sampled_from([rules for rules in Rules if rules is not Rules.FILE]),
    level_db=st.sampled_from([*DEVICE.levels_db, math.inf]),
    quiet_zones=st.lists(st.sampled_from(ZONES), unique=True).map(tuple),
    is_loaded=st.booleans(),
    is_other=st.booleans(),
    actuators_m=st.just(()) | st.tuples(*[st.floats(0.0, DEVICE.bar.length_m)] * len(DEVICE.actuators)),
)


@given(CHOICES)
def test_the_switches_of_a_choice_make_it_again(choice: Choice) -> None:
    assert changed(Choice(choice.device), to_plain(choice), DEVICE, OFFERS) == choice


@given(CHOICES)
def test_every_choice_has_rules_that_feel_at_its_level_where_it_may(choice: Choice) -> None:
    effects = effects_of(choice, DEVICE, None)
    assert effects.levels_db == (choice.level_db,)
    assert effects.have_clicks == (choice.source is Source.CLICK)
    assert (effects.drives is Drives.ZONES) == (choice.source is Source.ZONES)
    felt = effects.rules[-1]
    assert (felt.on, felt.zones) == (Trigger(choice.rules.value), None)
    quiet = effects.rules[:-1]
    assert [rule.zones for rule in quiet] == (
        [frozenset(map(ZONES.index, choice.quiet_zones))] if choice.quiet_zones else []
    )
    assert all(segment.level_db is None for rule in quiet for segment in rule.effect.envelope)
    if choice.rules is Rules.LIFT and choice.source is not Source.CLICK:
        assert felt.effect.envelope[0].duration_ns is not None


@pytest.mark.parametrize(
    ("switches", "named"),
    [
        ({"colour": 1}, "colour"),
        ({"device": "../secret"}, "device"),
        ({"source": "theirs"}, "source"),
        ({"rules": "file"}, "rules"),
        ({"level_db": 17}, "level_db"),
        ({"level_db": True}, "level_db"),
        ({"quiet_zones": "I"}, "quiet_zones"),
        ({"actuators_m": [0.1]}, "actuators_m"),
        ({"quiet_zones": ["VI"]}, "quiet_zones"),
        ({"is_loaded": 1}, "is_loaded"),
    ],
)
def test_what_is_no_switch_or_no_position_is_refused_by_name(switches: dict[str, Any], named: str) -> None:
    with pytest.raises(ChoiceError, match=named):
        changed(Choice("reference-a"), switches, DEVICE, OFFERS)


def test_another_device_is_offered_and_begins_with_no_quiet_zone() -> None:
    assert offered("my.toml").devices == ("my.toml", *shipped_names())
    assert OFFERS.devices[0] == "reference-a"
    assert sorted(OFFERS.devices) == shipped_names()
    choice = Choice("reference-a", quiet_zones=("IV",))
    assert changed(choice, {"device": "reference-d"}, DEVICE, OFFERS).quiet_zones == ()
    assert changed(choice, {"device": "reference-a"}, DEVICE, OFFERS) == choice


def test_a_rule_file_is_offered_only_where_it_was_given(tmp_path: Path) -> None:
    assert Rules.FILE not in OFFERS.rules
    rules = tmp_path / "rules.toml"
    rules.write_text(
        '[[effect]]\nname = "tap"\nenvelope = [["20 ms", "25 dB"]]\n[[rule]]\non = "lift"\neffect = "tap"\n', "utf-8"
    )
    offers = Offered(("reference-a",), rules)
    choice = changed(Choice("reference-a"), {"rules": "file"}, DEVICE, offers)
    (rule,) = effects_of(choice, DEVICE, rules).rules
    assert (rule.on, rule.effect.name) == (Trigger.LIFT, "tap")
