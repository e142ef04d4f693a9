"""Tracks fingers on the surface: the point of each contact in metres, and the zone that it touches.

Here, and nowhere else, it is decided which contacts are fingers of the surface, since a touch area may reach beyond it.
A contact is one from when it comes within REACH_M of the surface until it lifts; where its centre is beyond an edge, it
counts as at the edge. So a contact that trembles beside the surface does not come and go. A change to another surface
decides again for every contact that is down.

A finger that rests on an edge between two zones jitters by a digitizer unit and would change zones at every frame. So
zones have hysteresis: a contact stays in its zone until it is `zone_hysteresis` past the edge, and only then the zone
under it counts. The state is the last touch of each contact that is down; a contact that lifts is forgotten, so a
finger that comes down again starts without hysteresis. Hovering contacts are no touches.
"""

from enum import IntEnum
from typing import TYPE_CHECKING, Literal, NamedTuple

from base.points import is_between
from engine.touch.descriptor import Surface
from engine.touch.digitizer import Contact, TouchFrame

if TYPE_CHECKING:  # `tactable list` decodes touches and needs no device description
    from engine.device import Device, TouchAxis
    from engine.device.parts import TouchAcross

REACH_M = 8e-3  # a fingertip whose centre is farther beyond an end does not touch the bar: half its width at most
_new = tuple.__new__  # for the hot path: half the time of calling a named tuple's class


class ZoneState(IntEnum):
    """The role of a zone."""

    FREE = 0  # no finger: its motion does not matter
    QUIET = 1  # a finger that must not feel anything
    FELT = 2  # a finger that feels


class Touch(NamedTuple):
    """One finger on the surface. A finger between zones has no `zone` (None); a palm loads the surface alone."""

    contact_id: int
    position_m: complex  # real on a bar (base.points)
    zone: int | None
    is_palm: bool = False


class TouchSide:
    """Converts logical units of a digitizer along one of its axes to metres from the start of the surface."""

    def __init__(
        self, lies: "TouchAxis | TouchAcross", axis: Literal["x", "y"], length_m: float, surface: Surface
    ) -> None:
        field, self.length_m = surface.x if axis == "x" else surface.y, length_m
        active_m = lies.active_length_m
        if active_m is None:
            active_m = length_m - lies.start_margin_m - lies.end_margin_m
        self.column = 1 if axis == "x" else 2  # of a contact: half the time of asking for it by name
        self.start_m = lies.start_margin_m
        self.zero = field.logical_maximum if lies.flip else field.logical_minimum
        span = field.logical_maximum - field.logical_minimum
        self.m_per_unit = (-active_m if lies.flip else active_m) / span

    def position_m(self, contact: Contact) -> float:
        """Position of the contact, from 0 to the length of the side: beyond an end, that end."""
        position_m = self.start_m + (contact[self.column] - self.zero) * self.m_per_unit
        if 0.0 <= position_m <= self.length_m:
            return position_m
        return 0.0 if position_m < 0.0 else self.length_m

    def is_beside(self, contact: Contact) -> bool:
        """Whether the contact is more than REACH_M beyond an end of the side."""
        position_m = self.start_m + (contact[self.column] - self.zero) * self.m_per_unit
        return not -REACH_M <= position_m <= self.length_m + REACH_M


class TouchPosition:
    """How the digitizer's contacts lie on the surface of a device: along its side, and on a plate across it too."""

    def __init__(self, device: "Device", surface: Surface) -> None:
        lies, corner_m = device.touch_axis, device.surface.corner_m
        self.sides = [TouchSide(lies, lies.axis, corner_m.real, surface)]
        if lies.across is not None:
            self.sides.append(TouchSide(lies.across, "y" if lies.axis == "x" else "x", corner_m.imag, surface))

    def position_m(self, contact: Contact) -> complex:
        """Point of the contact (base.points): beyond an edge of the surface, at it."""
        along_m = self.sides[0].position_m(contact)
        return along_m if len(self.sides) == 1 else complex(along_m, self.sides[1].position_m(contact))

    def is_beside(self, contact: Contact) -> bool:
        """Whether the contact is more than REACH_M beyond an edge of the surface."""
        return any(side.is_beside(contact) for side in self.sides)


class ZoneFinder:
    """The zone of a point on the surface of a device, with hysteresis."""

    def __init__(self, device: "Device") -> None:
        self.hysteresis_m = device.zone_hysteresis_m
        self._corners_m = [(zone.start_m, zone.stop_m) for zone in device.zones]
        self._order = range(len(device.zones) - 1, -1, -1)

    def zone_at(self, position_m: complex, previous: int | None = None) -> int | None:
        """Index of the zone, None between zones. A contact stays in `previous` until past the edge by the hysteresis.

        An edge that zones share belongs to the last of them.
        """
        corners_m = self._corners_m
        if previous is not None and is_between(position_m, *corners_m[previous], self.hysteresis_m):
            return previous
        for zone in self._order:
            if is_between(position_m, *corners_m[zone]):
                return zone
        return None


class FingerTracker:
    """Follows every touching contact over the zones of one surface."""

    def __init__(self, device: "Device", surface: Surface) -> None:
        self._surface = surface
        self._frame = TouchFrame(0, ())
        self.change_bar(device)

    def change_bar(self, device: "Device") -> list[Touch]:
        """Track on another surface from now on; the fingers of the last frame that are on it."""
        self.position = TouchPosition(device, self._surface)
        self._zone_at = ZoneFinder(device).zone_at
        self.touches: dict[int, tuple[Contact, Touch]] = {}
        """The touching contacts of the last frame on the surface and their fingers, by contact id."""
        return self.track(self._frame)

    def track(self, frame: TouchFrame) -> list[Touch]:
        """The touching fingers of a frame, in its order; fingers in gaps between zones are included."""
        self._frame = frame
        previous, zones = self.touches, {}
        position_of, zone_at = self.position.position_m, self._zone_at
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
