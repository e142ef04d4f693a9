"""The plan: every step is left out once, each engine has its floor, and no condition is always the first."""

from dataclasses import replace

from engine.loop.realtime import ALL_STEPS, Step
from tactable.bench.latency.conditions import ECHO, TACTABLE, ZONES, BackgroundLoad, Condition, Plan

PLAN = Plan((125, 1000, 4000), tuple(BackgroundLoad), ALL_STEPS, has_echo=True, ablates=True, has_zones=True)


def test_steps_are_left_out_and_zones_played_once_at_the_middle_rate_under_stress() -> None:
    every = [condition for load in PLAN.loads for condition in PLAN.conditions(load)]
    left_out = [each for each in every if each.steps != ALL_STEPS and each.engine == TACTABLE]
    assert {(each.rate_hz, each.load) for each in left_out} == {(1000, BackgroundLoad.STRESS)}
    assert [each.steps_text for each in left_out] == ["none", *(f"all but {step}" for step in Step)]
    for plan, count in ((PLAN, 1), (replace(PLAN, has_zones=False), 0), (replace(PLAN, ablates=False), 0)):
        assert sum(each.engine == ZONES for load in plan.loads for each in plan.conditions(load)) == count


def test_each_engine_is_next_to_its_floor_and_rounds_begin_with_another_condition_and_measure_all() -> None:
    for load in (BackgroundLoad.IDLE, BackgroundLoad.STRESS):
        for rate_hz in PLAN.rates_hz:
            floor = PLAN.floor_of(Condition(TACTABLE, rate_hz, load, ALL_STEPS))
            assert floor == Condition(ECHO, rate_hz, load, ALL_STEPS)
            assert floor in PLAN.conditions(load)
            assert PLAN.floor_of(floor) is None
    assert PLAN.floor_of(Condition(TACTABLE, 1000, BackgroundLoad.THREAD, ALL_STEPS)) is None
    rounds = [conditions for _, load, conditions in PLAN.rounds(4) if load is BackgroundLoad.IDLE]
    assert len({conditions[0] for conditions in rounds}) == 4
    assert all(set(conditions) == set(PLAN.conditions(BackgroundLoad.IDLE)) for conditions in rounds)
