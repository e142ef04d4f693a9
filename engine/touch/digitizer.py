"""Assembles the reports of a digitizer into touch frames, as the Linux kernel's hid-multitouch driver does.

A report holds a few contact slots; a frame is every contact at one moment and may need several reports. The digitizer
says how many contacts a frame has (Contact Count) in the first report of the frame, and 0 in the others ("hybrid"
mode). Devices depart from this in known ways, which `quirks` lists by vendor and product, from the kernel's own table.

State (`Frame`): the contacts in range by their key, `received` of `expected` slots of the frame under way, and the
keys that the frame has mentioned. Invariants: a contact stays active until a report says that it lifted, until a frame
leaves it out (where the quirk says that this means "up"), or until the watchdog `expire` releases it. The watchdog is
for panels that repeat a resting finger: certified ones, as in Linux, and those whose device file says so. Others report
changes only. A frame is given out only when it is complete, so a finger never flickers between its reports. Where the
count is accurate, a gap of 30 ms or another scan time inside a frame means a lost report: the rest of that frame is
dropped, because the slots after it could not be told apart.

Nothing here raises or waits: broken reports are counted (`DigitizerCounters`), and time is an argument. The reports are
decoded by shifts and masks that are prepared once for each report (`ReportPlan`).

An interface may have several surfaces, such as a touch screen and a touch pad; its mode, which the kernel sets, says
which one reports. Unless one was chosen, the best is decoded until another one reports; the first that brings a contact
stays. So a panel is heard whatever its mode is, and a touch on another surface never takes a finger's place.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

from base.errors import TactableError
from engine.touch.descriptor import DescriptorError, Surface, read_surfaces
from engine.touch.quirks import Key, vendor_with_own_driver
from engine.touch.report_plan import ReportPlan, plan_surface, read

if TYPE_CHECKING:
    from engine.touch.debounce import Debounce

# Frames of live digitizers come every 2..26 ms. A report that comes later than this belongs to another one.
FRAME_SILENCE_NS = 30_000_000
RELEASE_AFTER_NS = 120_000_000  # watchdog: four times the slowest frame period; Linux waits 100 ms
_SCAN_TIME_TOLERANCE_NS = 25_000_000  # a scan time that is further than this from host time has been reset or wrapped
_SCAN_TIME_TICK_NS = 100_000  # HID Usage Tables, 0x0D:0x56; real ones tick each 92 to 131 us

# Reports that wait for a contact count in another report: more than any frame needs, few enough to bound memory.
_HELD_REPORTS = 16

# A contact id that comes down again in the frame in which it lifted is another finger: its number has this many added.
AGAIN = 1 << 32
_ID = AGAIN - 1
# For the hot path: no method look-up, and half the time of calling a named tuple's class.
_from_bytes, _new = int.from_bytes, tuple.__new__

_CONTACT_NUMBER = Key.SLOT_IS_CONTACT_NUMBER  # looked up once: the member of an enum costs 50 ns
# Reports that are not of the surface, after which a notice is given: 3 s of the slowest panel, 26 ms a report.
FOREIGN_NOTICED = 100


class DigitizerError(TactableError):
    """The device cannot be used as a touch surface; the message says why."""


class Contact(NamedTuple):
    """One finger: position in the logical units of the surface, always inside its logical range.

    `contact_id` is the device's, and stands for one finger from when it comes down until it lifts (AGAIN).

    `tip` is False while the finger hovers; `confidence` is False where the device takes the contact for a palm. As
    Linux does, certified devices alone are believed: others send the field and do not keep it.
    """

    contact_id: int
    x: int
    y: int
    tip: bool
    confidence: bool = True


class TouchFrame(NamedTuple):
    """Every contact in range at one moment, touching or hovering; contacts that left are not listed.

    `time_ns` is the host time of the report that completed the frame. `scan_time_ns` is the device's own time of the
    scan, moved to the host's time axis and free of transport jitter; `None` where the device reports none.
    """

    time_ns: int
    contacts: tuple[Contact, ...]
    scan_time_ns: int | None = None


@dataclass(slots=True)
class DigitizerCounters:
    """Counts of frames and of reports that were not used; the hot path counts instead of logging."""

    frames: int = 0
    foreign_reports: int = 0
    short_reports: int = 0
    lost_frames: int = 0
    excess_contacts: int = 0
    expired_frames: int = 0


@dataclass(slots=True)
class Frame:
    """The frame that is being assembled, and the contacts in range."""

    active: dict[int, Contact] = field(default_factory=dict)  # in range, by the id of the device, oldest first
    seen: set[int] = field(default_factory=set)  # keys that this frame has mentioned
    palms: list[Contact] = field(default_factory=list)  # they lifted, and are shown once more as palms
    lifted: set[int] = field(default_factory=set)  # keys that have lifted in this frame
    taken: int = 0  # contacts that were active or mentioned in this frame
    received: int = 0
    expected: int = 0
    ticks: int = 0  # scan time of the last report, in ticks of the device
    report_ns: int = 0  # when the last report came
    again: dict[int, int] = field(default_factory=dict)  # added to ids that came down again in the frame of their lift
    # Where contacts and their count come in different reports: reports that wait for the count, or a count for reports.
    held: list[tuple[ReportPlan, bytes]] = field(default_factory=list)
    held_count: int | None = None
    scan_ticks: int = 0  # scan time of the last frame that was complete
    scan_time_ns: int = 0  # the same on the host's axis

    def advance_scan(self, mask: int, now_ns: int) -> int:
        """Scan time of the frame, now complete, on the host's axis; host time after a reset or a pause.

        Devices reset the counter at a new touch, wrap it at its size instead of the declared maximum, and their ticks
        of 100 us are 92..131 us. So only steps of the counter are added up, while the sum agrees with host time.
        """
        time_ns = self.scan_time_ns + (self.ticks - self.scan_ticks & mask) * _SCAN_TIME_TICK_NS
        if not -_SCAN_TIME_TOLERANCE_NS <= time_ns - now_ns <= _SCAN_TIME_TOLERANCE_NS:
            time_ns = now_ns
        self.scan_ticks, self.scan_time_ns = self.ticks, time_ns
        return time_ns

    def start(self) -> None:
        """Start the next frame; the contacts stay."""
        self.received = 0
        self.seen.clear()
        self.palms.clear()
        self.lifted.clear()
        self.taken = len(self.active)


class Digitizer:
    """Frame assembler of one touch surface: the first of `surfaces`, until another of them reports.

    Not thread-safe. `decode_report` and `expire` never raise. Times are nanoseconds of one monotonic clock.
    """

    def __init__(
        self, surfaces: Sequence[Surface], vendor_id: int = 0, product_id: int = 0, *, is_chosen: bool = False
    ) -> None:
        self.surfaces, self.is_chosen = surfaces, is_chosen
        self.refused: Sequence[DescriptorError] = ()  # why other touch surfaces of the interface cannot be decoded
        self.counters = DigitizerCounters()
        self.foreign_ids: set[int] = set()  # report IDs that came and are not of the surface
        self.on_surface: Callable[[], None] = lambda: None  # called when another surface is decoded from now on
        self.on_foreign: Callable[[str], None] = lambda _: (
            None
        )  # told once of FOREIGN_NOTICED reports of another surface
        self._number = (vendor_id, product_id)
        self._decode_surface(surfaces[0])

    def _decode_surface(self, surface: Surface) -> None:
        """Decode the reports of a surface from now on."""
        self.surface, self.plan = surface, plan_surface(surface, *self._number)
        self.release_after_ns = RELEASE_AFTER_NS if self.plan.quirks.releases_when_silent else None
        """Time without a frame after which every contact is released; None: contacts are never released by time."""
        self.debounce: Debounce | None = None
        self.frame = Frame()
        self._shown_ns: int | None = None  # when the last frame came, where it listed a contact

    def decode_report(self, report: bytes, now_ns: int) -> TouchFrame | None:
        """Take one report as the device sent it, report ID first where it has one.

        Returns the frame that it completes; `None` where the frame goes on, or the report is foreign or too short.
        """
        if not report:  # LIFT_ALL
            return self._release_all(now_ns)
        report_id = report[0] if self.surface.uses_report_ids else 0
        plan, frame = self.plan.reports.get(report_id), self.frame
        if plan is None:
            return self._decode_foreign(report_id, report, now_ns)
        if len(report) < plan.needed_bytes:
            self.counters.short_reports += 1
            return None
        is_late = now_ns - frame.report_ns > FRAME_SILENCE_NS
        frame.report_ns = now_ns
        if self.plan.count_is_apart:
            return self._decode_apart(plan, report, now_ns, is_late)
        scan_time, count = plan.scan_time, plan.count
        ticks = frame.ticks
        if scan_time is not None:
            ticks = _from_bytes(report[scan_time.start : scan_time.stop], "little") >> scan_time.shift & scan_time.mask
        # A lost report shifts the frames after it only where the count says which slots to read.
        if frame.received and self.plan.count_is_accurate and (is_late or ticks != frame.ticks):
            self.counters.lost_frames += 1
            frame.start()
        if count is not None:
            announced = read(count, report)
            # The first report of a frame carries the total, the others 0; some devices repeat the total in each.
            if announced or (frame.received == 0 and ticks != frame.ticks and self.plan.quirks.frame_may_be_empty):
                frame.expected = announced
        frame.ticks = ticks
        self._take_contacts(plan, report)
        return None if frame.received < frame.expected else self._complete_frame(plan, now_ns)

    @property
    def foreign_notice(self) -> str | None:
        """A sentence naming the foreign reports and the remedy; None once the surface, or nothing, has reported."""
        if not self.foreign_ids or self.counters.frames:
            return None
        ids = ", ".join(f"{report_id:02x}" for report_id in sorted(self.foreign_ids))
        named = [f"{surface.name(*self._number)} ({surface.label})" for surface in self.surfaces]
        return (
            f"only reports {ids} come, and none of {named[self.surfaces.index(self.surface)]}, which is decoded; use "
            f"the surface whose report comes: {', '.join(named)}; where it is none, the device is in another mode"
        )

    def _decode_foreign(self, report_id: int, report: bytes, now_ns: int) -> TouchFrame | None:
        """Count a report of another surface or of no surface, or turn to the surface that it belongs to."""
        has_contact = any(slot.memory[1] for plan in self.plan.reports.values() for slot in plan.slots)
        for surface in () if self.is_chosen or has_contact else self.surfaces:
            is_pen = surface.is_stylus and not self.surface.is_stylus
            if not is_pen and any(layout.report_id == report_id for layout in surface.reports):
                self._decode_surface(surface)
                self.on_surface()
                return self.decode_report(report, now_ns)
        self.counters.foreign_reports += 1
        self.foreign_ids.add(report_id)
        if self.counters.foreign_reports == FOREIGN_NOTICED and (notice := self.foreign_notice):
            self.on_foreign(notice)
        return None

    def expire(self, now_ns: int) -> TouchFrame | None:
        """Frame due by time alone: no contact after a silence, or no longer one whose debounce time has passed."""
        if (due_ns := self.due_ns) is None or now_ns < due_ns:
            return None
        if self.debounce is not None and due_ns == self.debounce.due_ns:
            return TouchFrame(now_ns, self.debounce.settle(self.debounce.contacts, now_ns))
        return self._release_all(now_ns)

    @property
    def due_ns(self) -> int | None:
        """When `expire` has a frame, unless a report comes before; None: never."""
        due_ns = None if self.debounce is None else self.debounce.due_ns
        if self._shown_ns is not None and self.release_after_ns is not None:
            release_ns = self._shown_ns + self.release_after_ns
            due_ns = release_ns if due_ns is None else min(due_ns, release_ns)
        return due_ns

    def _release_all(self, now_ns: int) -> TouchFrame | None:
        """An empty frame where contacts are shown, else `None`."""
        is_shown = self._shown_ns is not None or self.due_ns is not None
        self.frame.active.clear()
        self.frame.start()
        self._shown_ns = None
        if self.debounce is not None:
            self.debounce.clear()
        self.counters.expired_frames += is_shown
        return TouchFrame(now_ns, ()) if is_shown else None

    def _decode_apart(self, plan: ReportPlan, report: bytes, now_ns: int, is_late: bool) -> TouchFrame | None:
        """Take a report of a device that sends contacts and their count in different reports, in either order."""
        frame = self.frame
        if is_late:
            frame.held.clear()
            frame.held_count = None
            frame.start()
        if plan.count is not None:
            frame.held_count = read(plan.count, report)
        else:
            frame.held.append((plan, report))
            del frame.held[:-_HELD_REPORTS]
        if frame.held_count is None or not frame.held:
            return None
        frame.expected = frame.held_count
        for held_plan, held_report in frame.held:
            self._take_contacts(held_plan, held_report)
        frame.held.clear()
        if frame.received < frame.expected:
            return None
        frame.held_count = None
        if plan.scan_time is not None:
            frame.ticks = read(plan.scan_time, report)
        return self._complete_frame(plan, now_ns)

    def _take_contacts(self, plan: ReportPlan, report: bytes) -> None:
        """Take the contacts of a report in order, until the frame has as many as were announced.

        Positions outside the logical range are clamped: a finger on the rim reads a few units outside.
        """
        frame, quirks = self.frame, self.plan.quirks
        active, seen, received = frame.active, frame.seen, frame.received
        wanted = frame.expected if self.plan.count_is_accurate else received + len(plan.slots)
        is_numbered, ignores_duplicates = quirks.key is _CONTACT_NUMBER, quirks.ignores_duplicates
        for memory, place, tip_at, id_at, valid_at, hover_at, confidence_at, x_at, y_at in plan.slots:
            if received >= wanted:
                break
            bits = _from_bytes(report[place], "little")
            if bits == memory[0]:
                # 40 % of recorded contacts are unchanged. Reusing the object takes a fifth of the time here, and lets
                # the finger tracker see by identity that the contact has not moved.
                contact_id = memory[1][0] & _ID
                if active.get(contact_id) is memory[1] and contact_id not in seen and not is_numbered:
                    received += 1
                    seen.add(contact_id)
                    continue
            shift, mask = valid_at
            if mask and not bits >> shift & mask:
                received += 1
                continue
            shift, mask = id_at
            contact_id = received if is_numbered else bits >> shift & mask
            is_active = contact_id in active
            if is_active and ignores_duplicates and contact_id in seen:
                continue
            received += 1
            if not is_active and not self._admit(contact_id):
                self.counters.excess_contacts += 1
                continue
            seen.add(contact_id)
            shift, mask = tip_at
            tip = bits >> shift & mask != 0
            if not tip and not bits >> hover_at[0] & hover_at[1]:
                if is_active:
                    shift, mask = confidence_at
                    if mask and not bits >> shift & mask:
                        frame.palms.append(active[contact_id]._replace(confidence=False))
                    del active[contact_id]
                    frame.lifted.add(contact_id)
                continue
            if contact_id in frame.lifted:
                frame.lifted.discard(contact_id)
                frame.again[contact_id] = frame.again.get(contact_id, 0) + AGAIN
            shift, mask, sign, minimum, maximum = x_at
            x = (bits >> shift & mask ^ sign) - sign
            if not minimum <= x <= maximum:
                x = min(max(x, minimum), maximum)
            shift, mask, sign, minimum, maximum = y_at
            y = (bits >> shift & mask ^ sign) - sign
            if not minimum <= y <= maximum:
                y = min(max(y, minimum), maximum)
            shift, mask = confidence_at
            number = contact_id + frame.again.get(contact_id, 0) if frame.again else contact_id
            contact = _new(Contact, (number, x, y, tip, not mask or bits >> shift & mask != 0))
            active[contact_id] = contact
            memory[:] = bits, contact
        frame.received = received

    def _admit(self, contact_id: int) -> bool:
        """Whether another contact can begin. A contact that lifts counts until the frame is complete."""
        key, most = self.plan.quirks.key, self.plan.maximum_contacts
        if key is Key.CONTACT_ID:
            self.frame.taken += 1
            return self.frame.taken <= most
        if key is Key.SLOT_IS_CONTACT_ID_MINUS_ONE:
            return 1 <= contact_id <= most
        return contact_id < most

    def _complete_frame(self, plan: ReportPlan, now_ns: int) -> TouchFrame:
        frame, active = self.frame, self.frame.active
        if self.plan.quirks.unseen_means_up:
            for contact_id in active.keys() - frame.seen:
                del active[contact_id]
        contacts = (*active.values(), *frame.palms)
        frame.start()
        self._shown_ns = now_ns if contacts else None
        if self.debounce is not None:
            contacts = self.debounce.settle(contacts, now_ns)
        self.counters.frames += 1
        scan_time_ns = None
        if plan.scan_time is not None:
            scan_time_ns = frame.advance_scan(plan.scan_time.mask, now_ns)
        return _new(TouchFrame, (now_ns, contacts, scan_time_ns))


def open_digitizer(
    descriptor: bytes, vendor_id: int = 0, product_id: int = 0, report_id: int | None = None
) -> Digitizer:
    """Open the digitizer of an interface: the surface with `report_id`, or the best one until another surface reports.

    Fingers come before a stylus, a touch screen before a touch pad. Raises `DescriptorError` when the descriptor is
    broken, `DigitizerError` when it holds no such surface.
    """
    number = f"{vendor_id:04x}:{product_id:04x}"
    if (vendor := vendor_with_own_driver(vendor_id)) is not None:
        raise DigitizerError(
            f"{vendor} device {number}: only its own driver decodes its reports; choose the /dev/input/event node of "
            "that driver, which `tactable list` shows where it is touched by fingers"
        )
    refused: list[DescriptorError] = []
    surfaces = sorted(read_surfaces(descriptor, refused), key=lambda surface: surface.rank)
    if not surfaces:
        raise DigitizerError(f"device {number} has no touch screen or touch pad")
    if report_id is not None:
        known = ", ".join(surface.name(vendor_id, product_id) for surface in surfaces)
        surfaces.sort(key=lambda surface: surface.report_id != report_id)
        if surfaces[0].report_id != report_id:
            raise DigitizerError(f"device {number} has no touch surface with report {report_id:02x}: choose {known}")
    digitizer = Digitizer(surfaces, vendor_id, product_id, is_chosen=report_id is not None)
    digitizer.refused = refused
    return digitizer
