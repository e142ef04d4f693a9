"""Laws of the fault texts: each is read as it is meant, and a wrong one is told with its remedy."""

import re

import pytest

from firmware_link.emulator.fault_plan import (
    FaultPlan,
    FaultPlanError,
    TimedFault,
    TimedKind,
    fault_help,
    parse_fault_plan,
)


@pytest.mark.parametrize("key", fault_help())
def test_the_example_of_each_key_is_understood(key: str) -> None:
    for example in fault_help()[key].split(": ")[1:]:
        assert parse_fault_plan(example.split(", ")[0]) != FaultPlan()


@pytest.mark.parametrize(
    "text",
    [
        *("drop=2", "drop", "drop=nan", "drift=5", "baud=0", "at_noise=1", "reboot=1.2.3s@4s"),
        *("stall=0.3s", "stall@3s", "stall=2s/1s", "hang_up=1@8s"),
    ],
)
def test_a_wrong_text_is_named_with_an_example_of_its_key(text: str) -> None:
    example = fault_help()[re.split("[=@]", text)[0]]
    with pytest.raises(FaultPlanError, match=re.escape(f"'{text}' is not understood; write it as in: {example}")):
        parse_fault_plan(text)


def test_a_key_that_is_unknown_or_given_twice_is_named() -> None:
    remedy = r"\(did you mean 'drop'\?\); there are bit_errors, drop"
    with pytest.raises(FaultPlanError, match=f"'dropp' is unknown {remedy}"):
        parse_fault_plan("dropp=0.1")
    with pytest.raises(FaultPlanError, match="'drop' is given twice"):
        parse_fault_plan("drop=0.1,drop=0.2")


def test_a_fault_comes_once_or_again_and_again() -> None:
    once = TimedFault(TimedKind.STALL, 100, 10, None)
    assert [once.begins_us(0), once.begins_us(100), once.begins_us(101)] == [100, 100, None]
    assert [once.ends_us(99), once.ends_us(100), once.ends_us(109), once.ends_us(110)] == [None, 110, 110, None]
    again = TimedFault(TimedKind.STALL, 100, 10, 100)
    assert [again.begins_us(0), again.begins_us(101), again.begins_us(200)] == [100, 200, 200]
    assert [again.ends_us(50), again.ends_us(205), again.ends_us(211)] == [None, 210, None]
