"""Objectives by name: numerators and denominators of the ratio that the drive of a state maximises."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from engine.touch import ZoneState
from precompute.predict.forms import Forms

Complex = NDArray[np.complex128]

QUIET_FLOOR = 1e-3
"""Standard contrast only: a quiet finger counts at least this fraction (-30 dB) of the bar's mean power.

Two actuators can silence one finger exactly, so without a floor the ratio has no greatest value. The averages of
`contrast` need none: no drive silences 32 different fingers at once.
"""


@dataclass(frozen=True)
class Problem:
    """Maximise min N / max D above a level (precompute.entries.bfgs): forms (form, frequency, actuator, actuator).

    `is_share`: the ratio is a share of energy; otherwise a ratio of powers, to be read in dB. `is_flat`: every drive
    has the same ratio, and another rule must choose.
    """

    name: str
    frequency_hz: NDArray[np.float64]
    in_band: NDArray[np.bool_]
    numerator: Complex
    denominator: Complex
    level: Complex
    is_share: bool
    is_flat: bool = False

    @property
    def stacks(self) -> tuple[Complex, Complex, Complex]:
        """Numerators, denominators and levels, the order that the kernels take them in."""
        return self.numerator, self.denominator, self.level

    def muted(self) -> "Problem":
        """The problem without actuators outside their bands: no power, and a denominator that stays definite."""
        outside = ~self.in_band
        if not outside.any():
            return self
        mute = np.where(outside[:, :, None] | outside[:, None, :], 0.0, 1.0)
        scale = np.einsum("jfaa->f", self.denominator).real / self.denominator.shape[0]
        fill = np.einsum("fa,f,ab->fab", outside, scale, np.eye(outside.shape[1]))
        return replace(
            self,
            numerator=np.ascontiguousarray(self.numerator * mute),
            denominator=np.ascontiguousarray(self.denominator * mute + fill),
            level=np.ascontiguousarray(self.level * mute),
        )

    def at(self, chosen: NDArray[np.int64]) -> "Problem":
        """The problem at some of its frequencies."""
        stacks = (np.ascontiguousarray(stack[:, chosen]) for stack in self.stacks)
        numerator, denominator, level = stacks
        return replace(
            self,
            frequency_hz=self.frequency_hz[chosen],
            in_band=self.in_band[chosen],
            numerator=numerator,
            denominator=denominator,
            level=level,
        )


def contrast(forms: Forms, states: Sequence[ZoneState]) -> Problem:
    """Weakest felt over strongest quiet finger, each power averaged over the sampled fingers.

    With nothing quiet it is the localized factor.
    """
    return _contrast("contrast", forms, states, forms.expected)


def standard_contrast(forms: Forms, states: Sequence[ZoneState]) -> Problem:
    """The same for the standard finger at the middle of its zone alone, QUIET_FLOOR added to every quiet power."""
    return _contrast("standard contrast", forms, states, forms.level, QUIET_FLOOR * forms.bar_mean)


def localized_factor(forms: Forms, states: Sequence[ZoneState]) -> Problem:
    """Share of the felt zones together, with the fingers on the bar."""
    felt = [zone for zone, state in enumerate(states) if state is ZoneState.FELT]
    energy = forms.energy[felt].sum(axis=0, keepdims=True)
    return _problem("localized factor", forms, states, energy, forms.total[None], is_share=True)


def fair_share(forms: Forms, states: Sequence[ZoneState]) -> Problem:
    """Smallest share of a felt zone, so that every felt zone gets one (docs/theory.md#objective-and-bound)."""
    felt = [zone for zone, state in enumerate(states) if state is ZoneState.FELT]
    return _problem("fair share", forms, states, forms.energy[felt], forms.total[None], is_share=True)


def paper(forms: Forms, states: Sequence[ZoneState]) -> Problem:
    """The published objective (11): share of the felt zones on the bar without fingers, whatever their level."""
    felt = [zone for zone, state in enumerate(states) if state is ZoneState.FELT]
    energy = forms.untouched_energy[felt].sum(axis=0, keepdims=True)
    problem = _problem("paper", forms, states, energy, forms.untouched_total[None], is_share=True)
    return replace(problem, level=problem.level[:0])


def level(forms: Forms, states: Sequence[ZoneState]) -> Problem:
    """Level of the weakest felt finger at full scale."""
    count = forms.total.shape[1]
    each = np.zeros((count, len(forms.frequency_hz), count, count), dtype=np.complex128)
    each[np.arange(count), :, np.arange(count), np.arange(count)] = 1.0
    felt = forms.level[_fingers(forms, states, ZoneState.FELT)]
    return _problem("level", forms, states, felt, each, is_share=False)


DEFAULT_OBJECTIVE = "contrast"
OBJECTIVES: dict[str, Callable[[Forms, Sequence[ZoneState]], Problem]] = {
    DEFAULT_OBJECTIVE: contrast,
    "standard contrast": standard_contrast,
    "localized factor": localized_factor,
    "fair share": fair_share,
    "paper": paper,
}
"""What a table can be built for. All but the paper's stand above the level and have the fingers in the plant."""


def _contrast(
    name: str, forms: Forms, states: Sequence[ZoneState], power: Complex, floor: Complex | float = 0.0
) -> Problem:
    felt, quiet = (_fingers(forms, states, state) for state in (ZoneState.FELT, ZoneState.QUIET))
    if not quiet:
        return localized_factor(forms, states)
    return _problem(name, forms, states, power[felt], power[quiet] + floor, is_share=False)


def _fingers(forms: Forms, states: Sequence[ZoneState], state: ZoneState) -> list[int]:
    return [finger for finger, zone in enumerate(forms.touched) if states[zone] is state]


def _problem(
    name: str, forms: Forms, states: Sequence[ZoneState], numerator: Complex, denominator: Complex, *, is_share: bool
) -> Problem:
    felt = forms.level[_fingers(forms, states, ZoneState.FELT)]
    return Problem(
        name=name,
        frequency_hz=forms.frequency_hz,
        in_band=forms.in_band,
        numerator=np.ascontiguousarray(numerator),
        denominator=np.ascontiguousarray(denominator),
        level=np.ascontiguousarray(felt),
        is_share=is_share,
        is_flat=is_share and len(numerator) == 1 and bool(np.allclose(numerator, denominator, rtol=1e-9, atol=0.0)),
    )
