"""Options of the clicks of a device."""

from dataclasses import dataclass


@dataclass(frozen=True)
class ClickOptions:
    """Requirements on clicks, and the effort to solve them.

    lengths_s: tried in turn until one reaches `wanted_db`. wanted_db: level that every felt finger reaches in 95 % of
    the sampled plants, and no more; None: the strongest. quiet_db: level that no quiet finger exceeds in 95 % of them.
    brake_s: time from which the felt fingers are limited like the quiet ones. slew_per_s: limit of the rate of
    displacement, full scales a second. tolerance_m: a finger lies within this distance of its place; None: within
    that of the device's spread. crowding: tones for each 1/length of an actuator's band. scenarios, trimmed, judged:
    numbers of sampled plants to optimise over, to trim on and to evaluate with; each has a seed of its own.
    """

    lengths_s: tuple[float, ...] = (0.03,)
    wanted_db: float | None = None
    quiet_db: float = 0.4
    brake_s: float | None = None
    slew_per_s: float | None = None
    tolerance_m: float | None = None
    crowding: float = 1.5
    scenarios: int = 40
    trimmed: int = 800
    judged: int = 200
    seed: int = 1


DEFAULT_OPTIONS = ClickOptions()
