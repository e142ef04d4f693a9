"""Recorded taps of a hammer to responses per newton, or without a force channel to decays that have the modes.

Theory of operation. A tap excites all modes at once; then the surface rings until it is still. All channels pass
through one converter, so that neither latency nor clocks count.

- *With a force channel* the response is sum(Y F*) / sum(|F|^2) over the taps of a place, the estimator H1 (Ewins, Modal
  Testing, 2000), at any frequency: every record begins and ends at rest. The force counts as 0 after the contact.
- *Without* one, the decay after the contact is a sum of r exp(p t), whatever the tap was. Its transform, sum
  r / (s - p) and a smooth rest, has the poles of the surface, which `pick_modes` finds. A second accelerometer that
  stays in place tells the shapes: the ratio of the residues is free of the tap.

A tap that would spoil this is refused by name: a channel at its end, a second contact, a decay that was cut.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from base.arrays import Array, Complex
from tactable.measure.sensor import FORCE, SensorError, SensorForm
from tactable.measure.sweep_fit import transform_at

BEFORE_S = 0.005  # of a record, before the contact
CONTACT_S = 0.01  # by when a contact is over: tips of plastic touch for 1 to 5 ms (ESTIMATE)
_BLOCK_S, _APART_S = 0.001, 0.3  # in which contacts are looked for; contacts nearer than this are of one tap
_LAG_S = 2.5e-4
# By whether force is known: the least contact, of the greatest, and for how many blocks before it all is calmer.
_LEAST_CONTACT, _CALM_BLOCKS = {True: 0.05, False: 0.003}, {True: 2, False: 8}
_RISE, _OF_NOISE = 3.0, 8.0  # of a contact over the blocks before it, and over the usual block
_SOON = 6  # blocks in which a contact has its greatest effect at the sensor
_ONE_CONTACT = 3  # blocks within which rises are of one contact
_LEFT, _TAPER = 0.01, 0.2  # of a decay: what may be left at its end, and the part whose end is made soft
_SOFT = 0.1  # of the greatest magnitude of the force's spectrum: below it a tip excites too little
_FLAT = 4  # samples one after the other at a channel's extreme: a converter at its end


class TapFault(Enum):
    """What spoils a tap, and the remedy."""

    CLIPPED = "clipped: a channel is at its end; tap more softly, or take a wider range"
    DOUBLE = "double hit: the hammer touched more than once; let it bounce off, or take a lighter one"
    SHORT = "too short a decay: the surface still rang at the end; wait longer between taps"
    LOST = "samples were lost; close other programs, or take a lower rate"


@dataclass(frozen=True)
class Tap:
    """A tap: when it was in the recording, and values (sample, channel) from BEFORE_S before until the next one.

    needed_s: how long it must ring, by its decay so far.
    """

    time_s: float
    values: Array
    faults: tuple[TapFault, ...]
    needed_s: float

    @property
    def text(self) -> str:
        """The tap and its faults in words."""
        named = "; ".join(fault.value for fault in self.faults)
        wait = f", {self.needed_s:.1f} s" if TapFault.SHORT in self.faults else ""
        return f"tap at {self.time_s:.2f} s: {named}{wait}"


def find_taps(recorded: Array, form: SensorForm, least: int = 1) -> list[Tap]:
    """The taps of a recording (sample, channel), each with its faults. Raises SensorError for fewer than `least`."""
    recorded = np.where(np.isfinite(recorded), recorded, np.nan)
    if np.isnan(recorded).all(axis=0).any():
        raise SensorError("a channel has no sample: check its connection, and the recording")
    values = recorded - np.nanmedian(recorded, axis=0)
    rate_hz, before = form.sample_rate_hz, round(BEFORE_S * form.sample_rate_hz)
    starts, contacts = list[int](), list[int]()
    for contact in _contacts(np.nan_to_num(values), form):
        if starts and contact - starts[-1] < _APART_S * rate_hz:
            contacts[-1] += 1
        else:
            starts.append(contact)
            contacts.append(1)
    if len(starts) < least:
        raise SensorError("no tap stands out of the noise: tap harder, or check the channels and their scales")
    ends = [*(start - before for start in starts[1:]), len(values)]
    tenth = min(round(0.1 * rate_hz), len(values))  # of a second: longer than a period of hum
    calm = values[: len(values) // tenth * tenth, form.acceleration].reshape(-1, tenth)
    noise = float(np.nanmin(np.nanstd(np.nan_to_num(calm), axis=1)))  # of the calmest stretch, with hum
    taps = []
    for start, end, count in zip(starts, ends, contacts, strict=True):
        own = slice(max(0, start - before), end)
        part = np.nan_to_num(values[own])
        size, declared = abs(part), abs(recorded[own]) >= 0.98 * np.array(form.clips_at)
        at_end = (size == size.max(axis=0)) & (size > 0)
        stays = np.logical_and.reduce([at_end[k : len(at_end) - _FLAT + k] for k in range(_FLAT)])
        left, needed_s = _decay(part[:, form.acceleration], rate_hz, noise)
        causes = {
            TapFault.LOST: bool(np.isnan(values[own]).any()),
            TapFault.CLIPPED: bool(declared.any() or stays.any()),
            TapFault.DOUBLE: count > 1,
            TapFault.SHORT: left > _LEFT,
        }
        faults = tuple(fault for fault, is_there in causes.items() if is_there)
        taps.append(Tap(start / rate_hz, part, faults, needed_s))
    return taps


def response_of(taps: Sequence[Tap], form: SensorForm, frequency_hz: Array) -> tuple[Complex, Array]:
    """Acceleration per newton (frequency,) and its relative standard error, NaN of a single tap.

    Raises SensorError where the tip is too soft for the highest frequencies.
    """
    turns = frequency_hz / form.sample_rate_hz
    stop = round((BEFORE_S + CONTACT_S) * form.sample_rate_hz)
    force = np.array([transform_at(tap.values[:stop, form.channels.index(FORCE)], turns) for tap in taps])
    moved = np.array([transform_at(_ended(tap.values[:, form.acceleration]), turns) for tap in taps])
    size = np.sqrt((abs(force) ** 2).mean(axis=0))
    if (weak := size < _SOFT * size.max()).any():
        raise SensorError(
            f"the taps have little force from {frequency_hz[weak].min():.4g} Hz on: take a harder tip or a lighter "
            "hammer, or lower --frequencies"
        )
    power = (abs(force) ** 2).sum(axis=0)
    response = (moved * force.conj()).sum(axis=0) / power
    freedom = max(len(taps) - 1, 1)
    scatter = np.sqrt((abs(moved - response * force) ** 2).sum(axis=0) / freedom / power)
    return response, scatter / abs(response) if len(taps) > 1 else np.full(len(turns), np.nan)


def decay_of(tap: Tap, form: SensorForm, channel: str, frequency_hz: Array) -> Complex:
    """Transform (frequency,) of what a channel of acceleration shows after the contact."""
    start = round((BEFORE_S + CONTACT_S) * form.sample_rate_hz)
    decay = _ended(tap.values[start:, form.channels.index(channel)])
    return transform_at(decay, frequency_hz / form.sample_rate_hz) / form.sample_rate_hz


def _contacts(values: Array, form: SensorForm) -> list[int]:
    """First samples of the blocks in which something touches: force, or else what jumps in the acceleration."""
    has_force = FORCE in form.channels
    if has_force:
        trigger = values[:, form.channels.index(FORCE)]
    else:  # a second difference: little of what rings below 300 Hz, much of the contact
        lag, moved = max(1, round(_LAG_S * form.sample_rate_hz)), values[:, form.acceleration]
        trigger = moved[2 * lag :] - 2 * moved[lag:-lag] + moved[: -2 * lag]
    size = max(1, round(_BLOCK_S * form.sample_rate_hz))
    blocks = abs(trigger[: len(trigger) // size * size]).reshape(-1, size).max(axis=1)
    if not len(blocks):
        return []
    calm = _CALM_BLOCKS[has_force]
    noise = _OF_NOISE * float(np.median(blocks))
    least = max(_LEAST_CONTACT[has_force] * blocks.max(), noise)
    before = np.array([blocks[max(0, k - calm) : k].max(initial=0.0) for k in range(len(blocks))])
    soon = np.array(
        [blocks[k : k + _SOON].max() for k in range(len(blocks))]
    )  # far away waves come one after the other
    rising = np.flatnonzero((blocks > noise / 2) & (soon > least) & (blocks > _RISE * before))
    return [int(k) * size for k in rising[np.diff(rising, prepend=-_ONE_CONTACT) >= _ONE_CONTACT]]


def _decay(acceleration: Array, rate_hz: float, noise: float) -> tuple[float, float]:
    """What is left at the end of a decay, of its beginning, and the seconds after which less than _LEFT would be."""
    ringing = acceleration[round((BEFORE_S + CONTACT_S) * rate_hz) :]
    tenth = len(ringing) // 10
    if tenth < 2:
        return 1.0, math.inf
    first, last = (math.sqrt(float((part**2).mean())) for part in (ringing[:tenth], ringing[-tenth:]))
    left = math.sqrt(max(last**2 - (1.5 * noise) ** 2, 0.0)) / max(first, 1e-300)
    seconds = len(ringing) / rate_hz
    return left, seconds * math.log(_LEFT) / math.log(min(max(left, 1e-9), 0.99))


def _ended(decay: Array) -> Array:
    """A decay whose end is made soft, so that noise and what is left do not leak."""
    fall = round(_TAPER * len(decay))
    out = decay.copy()
    out[len(out) - fall :] *= 0.5 + 0.5 * np.cos(np.pi * np.arange(1, fall + 1) / fall)
    return out
