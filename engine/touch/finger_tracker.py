"""Contacts to touches: the place of each finger on the bar and the zone it is in, with hysteresis at the edges."""

from bisect import bisect_right
from collections.abc import Sequence
from enum import IntEnum
from typing import NamedTuple

from engine.device import Device
from engine.touch.descriptor import Surface
from engine.touch.digitizer import Contact, TouchFrame

# The hot path: half the time of calling a named tuple's class.
_new = tuple.__new__


class ZoneState(IntEnum):
    """What a zone is to do."""

    FREE = 0
    """No finger: costs nothing."""
    QUIET = 1
    """A finger that must not feel."""
    FELT = 2
    """A finger that feels."""


def state_index(states: Sequence[ZoneState]) -> int:
    """One number for the states of all zones: the sum of state times 3**zone; 0 when all are free."""
    return sum(int(state) * 3**zone for zone, state in enumerate(states))


class Touch(NamedTuple):
    """One finger on the bar; `zone` is None in a gap between zones."""

    contact_id: int
    position_m: float
    zone: int | None


class TouchPosition:
    """Logical units of a surface to metres from the bar's start, along the axis that lies on the bar.

    The touch area may reach beyond the bar: a touch out there counts as one at the bar's end.
    """

    def __init__(self, device: Device, surface: Surface) -> None:
        axis, self.length_m = device.touch_axis, device.bar.length_m
        field = surface.x if axis.axis == "x" else surface.y
        active_m = axis.active_length_m
        if active_m is None:
            active_m = self.length_m - axis.start_margin_m - axis.end_margin_m
        self.column = 1 if axis.axis == "x" else 2  # of a contact: half the time of asking for it by name
        self.start_m = axis.start_margin_m
        self.zero = field.logical_maximum if axis.flip else field.logical_minimum
        span = field.logical_maximum - field.logical_minimum
        self.m_per_unit = (-active_m if axis.flip else active_m) / span

    def position_m(self, contact: Contact) -> float:
        """Where the contact is: from 0 to the length of the bar."""
        position_m = self.start_m + (contact[self.column] - self.zero) * self.m_per_unit
        if 0.0 <= position_m <= self.length_m:
            return position_m
        return 0.0 if position_m < 0.0 else self.length_m


class ZoneEdges:
    """The zone of a position, with hysteresis; zones are in order and may leave gaps."""

    def __init__(self, device: Device) -> None:
        self.starts_m = [zone.start_m for zone in device.zones]
        self.stops_m = [zone.stop_m for zone in device.zones]
        self.hysteresis_m = device.zone_hysteresis_m

    def zone_at(self, position_m: float, previous: int | None = None) -> int | None:
        """Index of the zone, None in a gap; a contact stays in `previous` until the hysteresis past its edge.

        An edge that two zones share belongs to the second.
        """
        if previous is not None:
            start_m = self.starts_m[previous] - self.hysteresis_m
            if start_m <= position_m <= self.stops_m[previous] + self.hysteresis_m:
                return previous
        zone = bisect_right(self.starts_m, position_m) - 1
        return zone if zone >= 0 and position_m <= self.stops_m[zone] else None


class FingerTracker:
    """Follows every contact that touches over the zones of one bar."""

    def __init__(self, device: Device, surface: Surface) -> None:
        self.position = TouchPosition(device, surface)
        self.edges = ZoneEdges(device)
        self._touches: dict[int, tuple[Contact, Touch]] = {}  # by contact id; one that has not moved is taken as it was

    def track(self, frame: TouchFrame) -> list[Touch]:
        """The fingers of a frame in its order, those in gaps between zones included; hovering contacts are none."""
        previous, zones = self._touches, {}
        position_of, zone_at = self.position.position_m, self.edges.zone_at
        touches = []
        for contact in frame.contacts:
            contact_id, _, _, tip, _ = contact
            if tip:
                last = previous.get(contact_id)
                if last is not None and last[0] is contact:
                    touch = last[1]
                else:
                    position_m = position_of(contact)
                    zone = zone_at(position_m, None if last is None else last[1].zone)
                    touch = _new(Touch, (contact_id, position_m, zone))
                zones[contact_id] = (contact, touch)
                touches.append(touch)
        self._touches = zones
        return touches

    def zones(self) -> list[tuple[int, int | None]]:
        """Contact and zone of each finger of the last frame."""
        return [(contact_id, touch[2]) for contact_id, (_, touch) in self._touches.items()]
