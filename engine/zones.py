"""Contacts to zone states: free, quiet or felt, with hysteresis at the zone edges."""

from bisect import bisect_right
from collections.abc import Callable, Collection, Sequence
from enum import IntEnum

from engine.descriptor import Surface
from engine.device import Device
from engine.digitizer import Contact, TouchFrame


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


ZoneRule = Callable[[Collection[int], int], Sequence[ZoneState]]
"""Indices of the touched zones and the number of zones to the state of every zone."""


def feel_every_touch(touched: Collection[int], number_of_zones: int) -> tuple[ZoneState, ...]:
    """The rule that every touched zone is felt and the others are free."""
    return tuple(ZoneState.FELT if zone in touched else ZoneState.FREE for zone in range(number_of_zones))


class TouchPosition:
    """Logical units of a surface to metres from the bar's start, along the axis that lies on the bar.

    The touch area may reach beyond the bar: a touch out there counts as one at the bar's end.
    """

    def __init__(self, device: Device, surface: Surface) -> None:
        axis, self._length_m = device.touch_axis, device.bar.length_m
        field = surface.x if axis.axis == "x" else surface.y
        active_m = axis.active_length_m
        if active_m is None:
            active_m = self._length_m - axis.start_margin_m - axis.end_margin_m
        self._reads_x = axis.axis == "x"
        self._start_m = axis.start_margin_m
        self._zero = field.logical_maximum if axis.flip else field.logical_minimum
        self._span = field.logical_maximum - field.logical_minimum
        self._active_m = -active_m if axis.flip else active_m

    def position_m(self, contact: Contact) -> float:
        """Where the contact is: from 0 to the length of the bar."""
        value = contact.x if self._reads_x else contact.y
        position_m = self._start_m + (value - self._zero) / self._span * self._active_m
        return min(max(position_m, 0.0), self._length_m)


class ZoneEdges:
    """The zone of a position, with hysteresis; zones are in order and may leave gaps."""

    def __init__(self, device: Device) -> None:
        self._starts_m = [zone.start_m for zone in device.zones]
        self._stops_m = [zone.stop_m for zone in device.zones]
        self._hysteresis_m = device.zone_hysteresis_m

    def zone_at(self, position_m: float, previous: int | None = None) -> int | None:
        """Index of the zone, None in a gap; a contact stays in `previous` until the hysteresis past its edge.

        An edge that two zones share belongs to the second.
        """
        if previous is not None:
            start_m = self._starts_m[previous] - self._hysteresis_m
            if start_m <= position_m <= self._stops_m[previous] + self._hysteresis_m:
                return previous
        zone = bisect_right(self._starts_m, position_m) - 1
        return zone if zone >= 0 and position_m <= self._stops_m[zone] else None


class ZoneTracker:
    """Follows every contact that touches over the zones of one bar."""

    def __init__(self, device: Device, surface: Surface, rule: ZoneRule = feel_every_touch) -> None:
        self.finger_positions_m: tuple[float, ...] = ()
        """Of the fingers that touch in the last frame, in its order, those in gaps between zones included."""
        self._number_of_zones = len(device.zones)
        self._position = TouchPosition(device, surface)
        self._edges = ZoneEdges(device)
        self._rule = rule
        self._zones: dict[int, int | None] = {}  # by contact id
        self._states: dict[frozenset[int | None], int] = {}  # the rule's answers, by the zones touched

    def track(self, frame: TouchFrame) -> int:
        """State of the zones in this frame, as `state_index` numbers it; hovering contacts do not count."""
        previous, zones = self._zones, {}
        positions_m = []
        for contact in frame.contacts:
            if contact.tip:
                position_m = self._position.position_m(contact)
                positions_m.append(position_m)
                contact_id = contact.contact_id
                zones[contact_id] = self._edges.zone_at(position_m, previous.get(contact_id))
        self._zones = zones
        self.finger_positions_m = tuple(positions_m)
        return self._state_of(frozenset(zones.values()))

    def _state_of(self, touched: frozenset[int | None]) -> int:
        state = self._states.get(touched)
        if state is None:
            zones = [zone for zone in touched if zone is not None]
            state = self._states[touched] = state_index(self._rule(zones, self._number_of_zones))
        return state
