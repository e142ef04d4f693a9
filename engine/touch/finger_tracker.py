"""Tracks fingers on the bar: the position of each contact in metres, and the zone that it touches.

Here, and nowhere else, it is decided which contacts are fingers of the bar, since a touch area may reach beyond it. A
contact is one from when it comes within REACH_M of the bar until it lifts; where its centre is beyond an end, it counts
as at the end. So a contact that trembles beside the bar does not come and go. A change to another bar decides anew for
every contact that is down.

A finger that rests on an edge between two zones jitters by a digitizer unit and would change zones at every frame. So
zones have hysteresis: a contact stays in its zone until it is `zone_hysteresis` past the edge, and only then the zone
under it counts. The state is the last touch of each contact that is down; a contact that lifts is forgotten, so a
finger that comes down again starts without hysteresis. Hovering contacts are no touches.
"""

from bisect import bisect_right
from enum import IntEnum
from typing import TYPE_CHECKING, NamedTuple

from engine.touch.descriptor import Surface
from engine.touch.digitizer import Contact, TouchFrame

if TYPE_CHECKING:  # `tactable list` decodes touches and needs no device description
    from engine.device import Device

REACH_M = 8e-3
"""A fingertip whose centre is farther beyond an end of the bar does not touch it: this is half its width at most."""
# For the hot path: half the time of calling a named tuple's class.
_new = tuple.__new__


class ZoneState(IntEnum):
    """The role of a zone."""

    FREE = 0
    """No finger: its motion does not matter."""
    QUIET = 1
    """A finger that must not feel anything."""
    FELT = 2
    """A finger that feels."""


class Touch(NamedTuple):
    """One finger on the bar. A finger in a gap between two zones has no `zone` (None); a palm loads the bar alone."""

    contact_id: int
    position_m: float
    zone: int | None
    is_palm: bool = False


class TouchPosition:
    """Converts logical units of a surface to metres from the start of the bar, along the axis that lies on the bar."""

    def __init__(self, device: "Device", surface: Surface) -> None:
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
        """Position of the contact, from 0 to the length of the bar: beyond an end, that end."""
        position_m = self.start_m + (contact[self.column] - self.zero) * self.m_per_unit
        if 0.0 <= position_m <= self.length_m:
            return position_m
        return 0.0 if position_m < 0.0 else self.length_m

    def is_beside(self, contact: Contact) -> bool:
        """Whether the contact is more than REACH_M beyond an end of the bar."""
        position_m = self.start_m + (contact[self.column] - self.zero) * self.m_per_unit
        return not -REACH_M <= position_m <= self.length_m + REACH_M


class ZoneEdges:
    """The zone of a position, with hysteresis; zones are in order and may leave gaps."""

    def __init__(self, device: "Device") -> None:
        self.starts_m = [zone.start_m for zone in device.zones]
        self.stops_m = [zone.stop_m for zone in device.zones]
        self.hysteresis_m = device.zone_hysteresis_m

    def zone_at(self, position_m: float, previous: int | None = None) -> int | None:
        """Index of the zone, None in a gap. A contact stays in `previous` until it is past the edge by the hysteresis.

        An edge that two zones share belongs to the zone that starts there.
        """
        if previous is not None:
            start_m = self.starts_m[previous] - self.hysteresis_m
            if start_m <= position_m <= self.stops_m[previous] + self.hysteresis_m:
                return previous
        zone = bisect_right(self.starts_m, position_m) - 1
        return zone if zone >= 0 and position_m <= self.stops_m[zone] else None


class FingerTracker:
    """Follows every touching contact over the zones of one bar."""

    def __init__(self, device: "Device", surface: Surface) -> None:
        self._surface = surface
        self._frame = TouchFrame(0, ())
        self.change_bar(device)

    def change_bar(self, device: "Device") -> list[Touch]:
        """Track on another bar from now on; the fingers of the last frame that are on it."""
        self.position = TouchPosition(device, self._surface)
        self.edges = ZoneEdges(device)
        self.touches: dict[int, tuple[Contact, Touch]] = {}
        """The touching contacts of the last frame on the bar and their fingers, by contact id."""
        return self.track(self._frame)

    def track(self, frame: TouchFrame) -> list[Touch]:
        """The touching fingers of a frame, in its order; fingers in gaps between zones are included."""
        self._frame = frame
        previous, zones = self.touches, {}
        position_of, zone_at = self.position.position_m, self.edges.zone_at
        touches = []
        for contact in frame.contacts:
            contact_id, _, _, tip, confidence = contact
            if tip:
                last = previous.get(contact_id)
                if last is not None and last[0] is contact:  # the digitizer reuses contacts that have not moved
                    touch = last[1]
                elif last is None and self.position.is_beside(contact):
                    continue
                else:
                    position_m = position_of(contact)
                    zone = zone_at(position_m, None if last is None else last[1].zone)
                    touch = _new(Touch, (contact_id, position_m, zone, not confidence))
                zones[contact_id] = (contact, touch)
                touches.append(touch)
        self.touches = zones
        return touches
