"""Real-time steps: each by itself optional, reported, and undone."""

import gc
import os
import sys
from collections.abc import Collection, Mapping
from pathlib import Path

import pytest

from engine.loop.realtime import ALL_STEPS, PRIORITY, Outcome, Step, System, parse_steps, real_time


class Machine(System):
    """A machine that allows some steps, and keeps what is in force."""

    def __init__(self, refused: Mapping[Step, Exception], processors: Collection[int] = (0, 1, 2)) -> None:
        self.refused = refused
        self.allowed = set(processors)
        self.policy = (os.SCHED_OTHER, 0)
        self.is_locked = False
        self.awake: int | None = None

    def _ask(self, step: Step) -> None:
        if step in self.refused:
            raise self.refused[step]

    def hold_dma_latency(self) -> int:
        self._ask(Step.DMA_LATENCY)
        self.awake = os.open(os.devnull, os.O_WRONLY)
        return self.awake

    def scheduler(self) -> tuple[int, int]:
        return self.policy

    def set_scheduler(self, policy: int, priority: int) -> None:
        self._ask(Step.PRIORITY)
        self.policy = (policy, priority)

    def processors(self) -> set[int]:
        return self.allowed

    def set_processors(self, processors: Collection[int]) -> None:
        self._ask(Step.AFFINITY)
        self.allowed = set(processors)

    def lock_memory(self) -> None:
        self._ask(Step.MEMORY)
        self.is_locked = True

    def unlock_memory(self) -> None:
        self.is_locked = False

    def in_force(self) -> dict[Step, bool]:
        return {
            Step.DMA_LATENCY: Path(f"/proc/self/fd/{self.awake}").exists(),
            Step.PRIORITY: self.policy == (os.SCHED_FIFO, PRIORITY),
            Step.MEMORY: self.is_locked,
            Step.AFFINITY: len(self.allowed) == 1,
            Step.SWITCH_INTERVAL: sys.getswitchinterval() < 1e-3,
            Step.COLLECTOR: not gc.isenabled() and gc.get_freeze_count() > 0,
        }


@pytest.mark.parametrize("step", ALL_STEPS)
def test_a_step_is_in_force_inside_and_undone_after_it_alone(step: Step) -> None:
    machine = Machine({})
    with real_time((step,), system=machine) as outcomes:
        assert [(outcome.step, outcome.in_force) for outcome in outcomes] == [(step, True)]
        assert machine.in_force() == {other: other is step for other in ALL_STEPS}
    assert not any(machine.in_force().values())


def test_all_steps_are_undone_after_an_error_too() -> None:
    machine = Machine({})
    with pytest.raises(RuntimeError), real_time(system=machine) as outcomes:
        assert [outcome.step for outcome in outcomes] == list(ALL_STEPS)
        assert all(machine.in_force().values())
        raise RuntimeError
    assert not any(machine.in_force().values())
    assert machine.allowed == {0, 1, 2}


@pytest.mark.parametrize("error", [PermissionError("not permitted"), AttributeError("no such call")])
@pytest.mark.parametrize("step", [Step.DMA_LATENCY, Step.PRIORITY, Step.MEMORY, Step.AFFINITY])
def test_a_step_that_is_refused_is_told_with_its_remedy_and_the_others_go_on(step: Step, error: Exception) -> None:
    with real_time(system=Machine({step: error})) as outcomes:
        (refused,) = [outcome for outcome in outcomes if not outcome.in_force]
    assert refused.step is step and str(error) in refused.finding and refused.remedy


def test_the_last_processor_is_taken_or_the_one_that_is_asked_for_where_there_are_more_than_one() -> None:
    with real_time((Step.AFFINITY,), system=Machine({}, processors=(3,))) as (outcome,):
        assert outcome == Outcome(Step.AFFINITY, outcome.finding, "use a machine with two or more")
    machine = Machine({})
    with real_time((Step.AFFINITY,), system=machine):
        assert machine.allowed == {2}
    with real_time((Step.AFFINITY,), processor=1, system=machine):
        assert machine.allowed == {1}


def test_steps_are_read_from_words() -> None:
    assert parse_steps("all") == ALL_STEPS
    assert parse_steps("none") == parse_steps("") == ()
    assert parse_steps("all,-priority") == tuple(step for step in ALL_STEPS if step is not Step.PRIORITY)
    assert parse_steps("memory, collector") == (Step.MEMORY, Step.COLLECTOR)
    with pytest.raises(ValueError, match="'nice' is unknown: write all, none"):
        parse_steps("nice")


def test_this_system_is_left_as_it_was() -> None:
    system, before = System(), (gc.isenabled(), sys.getswitchinterval())
    (policy, priority), processors = system.scheduler(), system.processors()
    with real_time() as outcomes:
        assert {outcome.step for outcome in outcomes} == set(ALL_STEPS)
    assert (gc.isenabled(), sys.getswitchinterval()) == before
    # What it starts is told to have the usual policy; that stays, here and from what ran in this process before.
    assert system.scheduler() == (policy | os.SCHED_RESET_ON_FORK, priority) or system.scheduler() == (policy, priority)
    assert system.processors() == processors
