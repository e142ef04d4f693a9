"""`Electrodes`: how the force of an electrostatic actuator follows its voltage, and how far from linear that is.

The force of an electrode goes as the square of its voltage. About a bias b, as fractions of the greatest voltage, a
swing d = min(b, 1 - b) stays between none and the greatest. A command a sin(wt) then gives

- one electrode:       (b + d a sin wt)^2, a force 2 b d a and a second harmonic d^2 a^2 / 2: ratio d a / 4 b;
- two, opposed, the second of them later by the phase gap p: (b + d a sin wt)^2 - (b + d a sin(wt + p))^2,
  a force 4 b d a |sin(p/2)| and a second harmonic d^2 a^2 |sin p|: ratio (d a / 2 b) |cos(p/2)|.

So two electrodes half a turn apart are linear by themselves and have the greatest force, whatever the command. One
electrode is linear if its voltage is the square root of b^2 + g s for a command s, with g = min(b^2, 1 - b^2): the core
of the firmware does so (core/electrode.c). Without a bias the force has twice the frequency of the voltage. That the
distance between electrode and mass changes as the actuator moves is left out: it is not published.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

_GREATEST_WORD = 65_535  # u16, as HELLO says the bias
LINEARISERS = ("board", "amplifier", "nothing")


@dataclass(frozen=True)
class Electrodes:
    """One electrode or two opposed ones; bias as a fraction of the greatest voltage; phase gap of the second one."""

    number: int
    bias: float
    phase_gap_deg: float
    linearised_by: Literal["board", "amplifier", "nothing"]

    def second_harmonic(self, amplitude: float) -> float:
        """Amplitude of the force's second harmonic over that of the force itself, at an amplitude of the command."""
        if self.linearised_by != "nothing":
            return 0.0
        depth = min(self.bias, 1 - self.bias) * amplitude / self.bias
        if self.number == 1:
            return depth / 4
        return depth / 2 * abs(math.cos(math.radians(self.phase_gap_deg / 2)))

    @property
    def bias_word(self) -> int:
        """The bias as the firmware's `electrode_bias`, of the greatest voltage / 65535."""
        return round(_GREATEST_WORD * self.bias)


def board_bias(electrodes: Iterable[Electrodes | None]) -> int:
    """The `electrode_bias` of the board that drives these; 0 where it does not linearise."""
    return next((each.bias_word for each in electrodes if each and each.linearised_by == "board"), 0)
