"""Faults that spoil a reading: clipping, noise, hum, lost samples, a drive that lapsed, a bar that is not steady."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from base.arrays import Array
from engine.device.quantity import GRAVITY_M_PER_S2 as GRAVITY_M_PER_S2
from tactable.measure.sensor import SensorForm
from tactable.measure.tone_fit import ToneFit, is_beside_hum


class Fault(Enum):
    """A cause that spoils readings, and its remedy."""

    CLIPPING = "clipping: the sensor or converter is at its end; drive less, or take a wider range"
    NOISE = "noise: the reading scatters; drive more, or take a quieter sensor"
    HUM = "mains hum: as loud as the reading, or beside its frequency; earth the sensor, or move the frequency"
    LOST_SAMPLES = (
        "samples were lost, or are not numbers: the converter or its program drops some; take a lower rate or a faster "
        "machine"
    )
    STALLED = "stalled: the sensor repeats one value; see to its power and wiring, then start it and its program again"
    LAPSED = "lapsed: the drive was renewed too late and stopped; leave the machine to the measurement, or use another"
    CLOCK_DRIFT = "clock drift: the converter's clock is off; the fit follows it, peaks and responses stay right"
    NOT_STEADY = "not steady: the response still changes; wait longer, or look for something loose"
    DISTORTION = "distortion: harmonics of the tone; drive less, or look for a rattle"
    TURNED = "turned: the sensor reads gravity with the other sign; turn it over, or its plug"
    NO_SIGNAL = "no signal: neither sensor nor loopback shows the tone; check wiring, sensor and amplifier"
    GAIN = "gain: gravity does not read as 9.81 m/s^2; correct the scale of the channel"
    OFFSET = "offset: the sensor reads more than gravity at rest; harmless to responses, but it takes from the range"
    LATENCY = "latency: samples come late, or differ from start to start; the loopback takes it out of responses"


_HARMLESS = {Fault.CLOCK_DRIFT, Fault.DISTORTION, Fault.TURNED, Fault.GAIN, Fault.OFFSET, Fault.LATENCY}
SPOILING = frozenset(Fault) - _HARMLESS  # a reading is repeated for these, and marked where that does not help


# What a reading may have of each fault; fractions are of the tone.
MOST_ERROR = 0.02
MOST_HUM_BESIDE = 0.01  # of a line that the window does not tell from the tone, by the hum of the bar at rest
MOST_DISTORTION = 0.1
MOST_DRIFT = 20e-6  # of the clock
MOST_PHASE_STEP_RAD = 0.05
MOST_GAIN, MOST_OFFSET_M_PER_S2 = 0.01, 0.5
_MOST_HUM = 1.0  # of a line that the window tells from the tone
_CLIP = 0.98  # of the greatest value
_MOST_LATENCY_S, _MOST_JITTER_S = 0.02, 0.004  # the jitter is between starts; a block of samples is half as long


def is_clipped(values: Array, form: SensorForm) -> bool:
    """Whether samples (sample, channel) reach the declared greatest value, or stand still at their extremes."""
    greatest = np.nanmax(abs(values), axis=0)
    if (greatest >= _CLIP * np.array(form.clips_at)).any():
        return True
    # Without a declared end: a sine passes its crest, a clipped one stays there for many samples.
    acceleration = values[:, form.acceleration]
    high, low = np.nanmax(acceleration), np.nanmin(acceleration)
    if high == low:
        return False
    at_end = max(np.count_nonzero(acceleration == high), np.count_nonzero(acceleration == low))
    return bool(at_end > max(8, 0.05 * len(acceleration)))


def is_stalled(acceleration: Array, most: int) -> bool:
    """Whether more samples (sample,) than `most`, one after the other, have the same value."""
    changes = np.flatnonzero(np.diff(acceleration) != 0)
    return bool(np.diff(changes, prepend=-1, append=len(acceleration) - 1).max() > most)


def find_click_faults(values: Array, form: SensorForm) -> tuple[Fault, ...]:
    """Faults of the samples (sample, channel) of a click, from rest to rest."""
    acceleration, clips = values[:, form.acceleration], is_clipped(values, form)
    causes = {
        Fault.CLIPPING: clips,
        Fault.STALLED: not clips and is_stalled(acceleration, len(acceleration) - 1),
        Fault.LOST_SAMPLES: bool(np.isnan(values).any()),
        Fault.OFFSET: has_offset(float(np.nanmean(acceleration))),
    }
    return tuple(fault for fault, is_there in causes.items() if is_there)


def has_offset(mean_m_per_s2: float) -> bool:
    """Whether a sensor, which may lie in any way and pass direct current, reads more than gravity."""
    return abs(mean_m_per_s2) > GRAVITY_M_PER_S2 + MOST_OFFSET_M_PER_S2


def find_faults(
    fit: ToneFit, values: Array, form: SensorForm, reference: int | None, hum_at_rest: float
) -> tuple[Fault, ...]:
    """Faults of one steady window (sample, channel), the most serious first.

    reference: index of the loopback channel, None without one. hum_at_rest: of the mains, with the bar at rest, m/s^2.
    """
    channel, found = form.acceleration, list[Fault]()
    size = max(float(abs(fit.phasor[channel])), 1e-300)
    steady = channel if reference is None else reference
    if is_clipped(values, form):
        found.append(Fault.CLIPPING)
    # A sine leaves a value within a period, however coarse the steps of the converter.
    elif is_stalled(values[:, channel], math.ceil(form.sample_rate_hz / fit.frequency_hz)):
        found.append(Fault.STALLED)
    has_step = fit.phase_step_rad(steady) > MOST_PHASE_STEP_RAD and fit.error(steady) > MOST_ERROR / 2
    if has_step or np.isnan(values).any():
        found.append(Fault.LOST_SAMPLES)
    beside = is_beside_hum(fit.frequency_hz, fit.duration_s) and hum_at_rest > MOST_HUM_BESIDE * size
    # Hum that the window tells from the tone is taken out by the fit; it spoils only what scatters.
    is_loud = fit.hum[channel] > _MOST_HUM * size and fit.error(channel) > MOST_ERROR
    if beside or is_loud:
        found.append(Fault.HUM)
    if fit.error(channel) > MOST_ERROR and not {Fault.LOST_SAMPLES, Fault.STALLED} & {*found}:
        found.append(Fault.NOISE)
    if fit.distortion[channel] > MOST_DISTORTION * size and Fault.NOISE not in found:
        found.append(Fault.DISTORTION)
    if has_offset(float(fit.mean[channel])):
        found.append(Fault.OFFSET)
    return tuple(found)


@dataclass(frozen=True)
class GravityCheck:
    """Gain less 1, and offset in m/s^2, with the faults that they are."""

    gain: float
    offset_m_per_s2: float
    faults: tuple[Fault, ...]


def check_gravity(level_m_per_s2: float, turned_m_per_s2: float) -> GravityCheck:
    """The check of a sensor that passes direct current, from its means lying level and turned over.

    Level it reads g (1 + gain) + offset, turned over -g (1 + gain) + offset (ISO 16063-16).
    """
    gain = (level_m_per_s2 - turned_m_per_s2) / (2 * GRAVITY_M_PER_S2) - 1
    offset = (level_m_per_s2 + turned_m_per_s2) / 2
    found = {
        Fault.TURNED: gain < -1,
        Fault.GAIN: gain >= -1 and abs(gain) > MOST_GAIN,
        Fault.OFFSET: abs(offset) > MOST_OFFSET_M_PER_S2,
    }
    return GravityCheck(gain, offset, tuple(fault for fault, is_there in found.items() if is_there))


def find_late(latencies_s: Sequence[float]) -> tuple[Fault, ...]:
    """LATENCY where samples come late, or later at one start than at another."""
    if not latencies_s:
        return ()
    is_late = max(latencies_s) > _MOST_LATENCY_S
    return (Fault.LATENCY,) if is_late or max(latencies_s) - min(latencies_s) > _MOST_JITTER_S else ()
