"""Study of one placement: clicks of several lengths, and clicks that are optimised over several numbers of plants."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from engine.device import Device
from engine.touch import Placement
from precompute.clicks import DEFAULT_OPTIONS, Click, ClickOptions, ClickSolver


@dataclass(frozen=True, eq=False)
class Study:
    """Clicks of one placement: `by_length` has the scenarios of the options, `by_scenarios` their first length."""

    device: Device
    placement: Placement
    options: ClickOptions
    by_length: dict[float, Click]
    by_scenarios: dict[int, Click]

    @cached_property
    def clicks(self) -> tuple[tuple[str, float, int, Click], ...]:
        """Every click with the name of the varied option, its length and its scenarios."""
        lengths = [("length", length_s, self.options.scenarios, c) for length_s, c in self.by_length.items()]
        counts = [("scenarios", self.options.lengths_s[0], count, c) for count, c in self.by_scenarios.items()]
        return (*lengths, *counts)


def run_study(
    device: Device,
    placement: Placement,
    *,
    lengths_s: Sequence[float],
    scenarios: Sequence[int],
    options: ClickOptions = DEFAULT_OPTIONS,
    on_progress: Callable[[float], None],
) -> Study:
    """Solve a placement at every length and with every number of scenarios, evaluated on the same sampled plants.

    `on_progress` gets the fraction done.
    """
    usual = (options.lengths_s[0], options.scenarios)
    wanted = dict.fromkeys([(length_s, usual[1]) for length_s in lengths_s] + [(usual[0], n) for n in scenarios])
    solved = dict[tuple[float, int], Click]()
    for length_s, count in wanted:
        asked = replace(options, lengths_s=(length_s,), scenarios=count)
        solved[length_s, count] = ClickSolver(device, asked).solve(placement)
        on_progress(len(solved) / len(wanted))
    return Study(
        device=device,
        placement=placement,
        options=options,
        by_length={length_s: solved[length_s, usual[1]] for length_s in lengths_s},
        by_scenarios={count: solved[usual[0], count] for count in scenarios},
    )
