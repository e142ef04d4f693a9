"""Gravity as a check of a sensor that passes direct current: level and turned over, it tells gain and offset.

Level it reads g (1 + gain) + offset, turned over -g (1 + gain) + offset (ISO 16063-16).
"""

from dataclasses import dataclass

from tactable.measure.faults import GRAVITY_M_PER_S2, MOST_GAIN, MOST_OFFSET_M_PER_S2, Fault


@dataclass(frozen=True)
class GravityCheck:
    """Gain less 1, and offset in m/s^2, with the faults that they are."""

    gain: float
    offset_m_per_s2: float
    faults: tuple[Fault, ...]


def check_gravity(level_m_per_s2: float, turned_m_per_s2: float) -> GravityCheck:
    """The check from the means of the sensor lying level and turned over."""
    gain = (level_m_per_s2 - turned_m_per_s2) / (2 * GRAVITY_M_PER_S2) - 1
    offset = (level_m_per_s2 + turned_m_per_s2) / 2
    found = {
        Fault.TURNED: gain < -1,
        Fault.GAIN: gain >= -1 and abs(gain) > MOST_GAIN,
        Fault.OFFSET: abs(offset) > MOST_OFFSET_M_PER_S2,
    }
    return GravityCheck(gain, offset, tuple(fault for fault, is_there in found.items() if is_there))
