"""Rates, loads and steps to the conditions of a measurement, in an order that lets all meet the same machine."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from engine.loop.realtime import Step
from tactable.bench.latency.load import Load
from tactable.bench.latency.run import ECHO, LONG_WAY, TACTABLE, Condition


@dataclass(frozen=True)
class Plan:
    """What to measure; `rates_hz` rise."""

    rates_hz: tuple[int, ...]
    loads: tuple[Load, ...]
    steps: tuple[Step, ...]
    has_echo: bool
    """The C echo engine is there, as a floor."""
    ablates: bool
    """Without each step, without all, and without the fast path."""

    @property
    def middle_hz(self) -> int:
        """The rate at which steps are left out."""
        return self.rates_hz[len(self.rates_hz) // 2]

    def conditions(self, load: Load) -> tuple[Condition, ...]:
        """Every condition beside a load, each engine next to its floor."""
        if load is Load.THREAD:
            return (Condition(TACTABLE, self.middle_hz, load, self.steps),)
        engines = (TACTABLE, ECHO) if self.has_echo else (TACTABLE,)
        both = [Condition(engine, rate_hz, load, self.steps) for rate_hz in self.rates_hz for engine in engines]
        if self.ablates and load is self._ablation_load:
            both += [Condition(TACTABLE, self.middle_hz, load, steps) for steps in self._ablations()]
            both.append(Condition(LONG_WAY, self.middle_hz, load, self.steps))
        return tuple(both)

    @property
    def _ablation_load(self) -> Load:
        return Load.STRESS if Load.STRESS in self.loads else Load.IDLE

    def _ablations(self) -> Iterator[tuple[Step, ...]]:
        yield ()
        if len(self.steps) > 1:
            for left_out in self.steps:
                yield tuple(step for step in self.steps if step is not left_out)

    def rounds(self, count: int) -> Iterator[tuple[int, Load, Sequence[Condition]]]:
        """Round, load and its conditions: each round begins with another one, so that none is always the first."""
        for number in range(count):
            for load in self.loads:
                conditions = self.conditions(load)
                first = number % len(conditions)
                yield number, load, (*conditions[first:], *conditions[:first])

    @property
    def segments_a_round(self) -> int:
        """How many stretches of measurement a round has."""
        return sum(len(self.conditions(load)) for load in self.loads)

    def floor_of(self, condition: Condition) -> Condition | None:
        """What to compare with: the C echo engine beside the same load, as fast and with the same steps."""
        if condition.engine != TACTABLE:
            return None
        floor = Condition(ECHO, condition.rate_hz, condition.load, condition.steps)
        return floor if floor in self.conditions(condition.load) else None
