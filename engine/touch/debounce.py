"""When a contact has lifted, by the device file: after a silence, or after a gap that is too long for a dropped finger.

A panel that drops a resting finger reports a lift, and within some 30 ms the same finger again, mostly by another
number. With `debounce` a contact that lifts stays where it was for that long. A contact that comes down meanwhile,
within CLOSEST_M along the bar, goes on with it under its number; any other is a new one. The price: every lift is known
that much later. A touch is known at once.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from engine.touch.digitizer import AGAIN, RELEASE_AFTER_NS, Contact, Digitizer
from engine.touch.finger_tracker import TouchPosition
from engine.touch.placement import CLOSEST_M
from engine.touch.sources.own_reports import are_ours

if TYPE_CHECKING:
    from engine.device import Device


class Debounce:
    """Keeps contacts over gaps shorter than `hold_ns`.

    `column` is the place of the coordinate along the bar in a contact; a contact that comes back is at most `near`
    logical units away.
    """

    def __init__(self, hold_ns: int, column: int, near: float) -> None:
        self.settings = (hold_ns, column, near)
        self.contacts: tuple[Contact, ...] = ()  # those of the panel's last frame
        self._numbers: dict[int, int] = {}  # shown number by the panel's number
        self._shown: dict[int, Contact] = {}  # by the number shown
        self._gaps: dict[int, int] = {}  # contacts without touch: when they lifted, the longest gone first

    @property
    def due_ns(self) -> int | None:
        """When the next lift has lasted; None: every contact touches."""
        return next(iter(self._gaps.values())) + self.settings[0] if self._gaps else None

    def clear(self) -> None:
        """Every contact has lifted, without a gap."""
        self.contacts = ()
        for kept in (self._numbers, self._shown, self._gaps):
            kept.clear()

    def settle(self, contacts: Sequence[Contact], now_ns: int) -> tuple[Contact, ...]:
        """The contacts of a frame, those in a gap among them where they were; hovering ones stay as they are."""
        self.contacts = tuple(contacts)
        before, self._numbers = self._numbers, {}
        shown, fresh = dict[int, Contact](), list[Contact]()
        for contact in contacts:
            if contact.tip and contact.contact_id in before:
                self._show(contact, before[contact.contact_id], shown)
            elif contact.tip:
                fresh.append(contact)
        for number in self._shown.keys() - shown.keys():
            self._gaps.setdefault(number, now_ns)
        self._gaps = {number: at_ns for number, at_ns in self._gaps.items() if now_ns - at_ns < self.settings[0]}
        for contact in fresh:
            self._show(contact, self._number_of(contact, shown), shown)
        held = {number: self._shown[number] for number in self._gaps}
        hovering = [contact for contact in contacts if not contact.tip and contact.contact_id not in held]
        self._shown = shown | held
        return (*self._shown.values(), *hovering)

    def _show(self, contact: Contact, number: int, shown: dict[int, Contact]) -> None:
        self._numbers[contact.contact_id] = number
        shown[number] = contact if number == contact.contact_id else contact._replace(contact_id=number)

    def _number_of(self, contact: Contact, shown: dict[int, Contact]) -> int:
        """The number of the nearest contact in a gap, whose gap ends; without a near one, an unused number."""
        _, column, near = self.settings
        away = {number: abs(self._shown[number][column] - contact[column]) for number in self._gaps}
        number = min(away, key=away.__getitem__, default=None)
        if number is not None and away[number] <= near:
            del self._gaps[number]
            return number
        number = contact.contact_id
        while number in shown or number in self._gaps:
            number += AGAIN
        return number


def fit_releases(digitizer: Digitizer, device: "Device") -> None:
    """Have a digitizer release contacts as the device file says; without a word of it, by its class."""
    axis, surface = device.touch_axis, digitizer.surface
    if axis.silence_s is not None and not are_ours(surface):
        digitizer.release_after_ns = round(1e9 * axis.silence_s)
    else:
        digitizer.release_after_ns = RELEASE_AFTER_NS if digitizer.plan.quirks.releases_when_silent else None
    along = TouchPosition(device, surface).sides[0]
    settings = (round(1e9 * axis.debounce_s), along.column, CLOSEST_M / abs(along.m_per_unit))
    if not axis.debounce_s:
        digitizer.debounce = None
    elif digitizer.debounce is None or digitizer.debounce.settings != settings:
        digitizer.debounce = Debounce(*settings)
