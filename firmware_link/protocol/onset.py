"""A shape and the moment of its SET to the gain at any time after."""

from collections.abc import Sequence
from dataclasses import dataclass

from firmware_link.protocol.errors import MessageError
from firmware_link.protocol.messages import NUMBER_OF_SHAPES, SHAPE_FULL_GAIN, SHAPE_STEPS, SHAPE_TIME_US, Result, Shape

US_PER_S = 1_000_000


@dataclass(frozen=True)
class OnsetStep:
    """Hold this gain until this long after the start."""

    until_s: float
    gain: float


def make_shape(index: int, steps: Sequence[OnsetStep]) -> Shape:
    """The message that defines these steps, at most SHAPE_STEPS; raises MessageError for times that fall."""
    times = [round(step.until_s * US_PER_S / SHAPE_TIME_US) for step in steps]
    if times != sorted(times):
        raise MessageError(
            f"the steps of onset {index + 1} end at {[s.until_s for s in steps]} s; expected rising times"
        )
    gains = [round(step.gain * SHAPE_FULL_GAIN) for step in steps]
    words = [word for pair in zip(times, gains, strict=True) for word in pair]
    return Shape(index, len(steps), *words, *[0] * (2 * SHAPE_STEPS - len(words)))


@dataclass(frozen=True)
class Onset:
    """How a drive begins: each step, as (until_us, gain), holds its gain in 1/SHAPE_FULL_GAIN until its time."""

    start_us: int
    steps: tuple[tuple[int, int], ...]

    def gain_at(self, device_us: int) -> int:
        """Gain at a device time from the start on."""
        elapsed_us = device_us - self.start_us
        return next((gain for until_us, gain in self.steps if elapsed_us < until_us), SHAPE_FULL_GAIN)

    def next_step_us(self, device_us: int) -> int | None:
        """Device time of the first change after this one; None after the last."""
        times_us = (self.start_us + until_us for until_us, _ in self.steps)
        return next((time_us for time_us in times_us if time_us > device_us), None)


class ShapeStore:
    """A device's memory for the shapes that a SET may choose."""

    def __init__(self) -> None:
        self._steps: list[tuple[tuple[int, int], ...]] = [()] * NUMBER_OF_SHAPES

    def define(self, shape: Shape) -> Result:
        """Keep a shape, in place of the one that its index had."""
        pairs = ((shape.until_1, shape.gain_1), (shape.until_2, shape.gain_2), (shape.until_3, shape.gain_3))
        steps = tuple((SHAPE_TIME_US * until, gain) for until, gain in pairs[: shape.steps])
        if shape.index >= NUMBER_OF_SHAPES or shape.steps > SHAPE_STEPS or list(steps) != sorted(steps, key=_until):
            return Result.OUT_OF_RANGE
        self._steps[shape.index] = steps
        return Result.OK

    def onset(self, number: int, start_us: int) -> Onset:
        """The onset that a SET asks for by `number`: 0 is none, k is shape k - 1; raises IndexError for others."""
        return Onset(start_us, ((), *self._steps)[number])


def _until(step: tuple[int, int]) -> int:
    return step[0]
