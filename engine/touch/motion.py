"""Touch frames to the velocity of each finger along the bar, for effects that follow a drag."""

import math
from dataclasses import dataclass

from engine.device import Device
from engine.touch.descriptor import Surface
from engine.touch.digitizer import TouchFrame
from engine.touch.finger_tracker import TouchPosition

SMOOTHING_NS = 20_000_000
"""Time constant: two frames of the usual 8 ms digitizer and a half; a step in velocity is 92 % there after 50 ms."""


@dataclass(frozen=True, slots=True)
class _Finger:
    """Where a finger was, when, and how fast."""

    position_m: float
    time_ns: int
    velocity_m_per_s: float


class FingerMotion:
    """Follows every contact that touches; time is the digitizer's own where it has one, else the host's."""

    def __init__(self, device: Device, surface: Surface) -> None:
        self._position = TouchPosition(device, surface)
        self._fingers: dict[int, _Finger] = {}
        self._has_scan_time = False

    def track(self, frame: TouchFrame) -> dict[int, float]:
        """Velocity in m/s by contact id, positive towards the bar's end; 0 for a finger that has just come down."""
        has_scan_time = frame.scan_time_ns is not None
        previous = self._fingers if has_scan_time == self._has_scan_time else {}  # two clocks are not subtracted
        self._has_scan_time = has_scan_time
        time_ns = frame.time_ns if frame.scan_time_ns is None else frame.scan_time_ns
        self._fingers = {
            contact.contact_id: _move(previous.get(contact.contact_id), self._position.position_m(contact), time_ns)
            for contact in frame.contacts
            if contact.tip
        }
        return {contact_id: finger.velocity_m_per_s for contact_id, finger in self._fingers.items()}


def _move(before: _Finger | None, position_m: float, time_ns: int) -> _Finger:
    """The finger at its new place; velocity through a first-order low-pass that does not depend on the frame rate."""
    if before is None:
        return _Finger(position_m, time_ns, 0.0)
    elapsed_ns = time_ns - before.time_ns
    if elapsed_ns <= 0:
        return before
    seen_m_per_s = (position_m - before.position_m) * 1e9 / elapsed_ns
    share = 1.0 - math.exp(-elapsed_ns / SMOOTHING_NS)
    return _Finger(position_m, time_ns, before.velocity_m_per_s + share * (seen_m_per_s - before.velocity_m_per_s))
