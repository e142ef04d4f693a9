"""One-slot mailbox of commands, latest wins: what the host wants to sound, as SET, PLAY and KEEPALIVE when due.

Theory of operation
-------------------
The outbox decides which command goes out next and when, numbers it, stamps it with the device's clock and encodes it.
Its state is a pair:

- the *slot*: the command that waits, at most one. A newer command replaces it, and the replaced one is counted and
  never sent: a finger that moves ten times while the line is busy deserves the tenth answer, and a queue of the ten
  would deliver nine wrong ones late.
- what *sounds*: the last drive or click that was sent. It is held by renewals until another command replaces it:
  a drive by its SET again (each SET carries all there is, so a lost frame needs no repair), a click by KEEPALIVE,
  since a second PLAY would start it again. When a click has ended, silence sounds, and is renewed by SET too: had
  the SET that silenced an earlier drive been lost, a KEEPALIVE would hold that drive.

Invariants:

- No more commands go out within a lease than a sequence number tells apart (`Lease.free_ns`).
- The device never gets a PLAY that it would refuse because two clicks sound already: a mirror of the device's own
  `Player`, with a margin for the jitter of the line, says when there is room, and the click waits in the slot.
- While the device changes over to another basis (`holds_clicks`), no click goes out: its weights are of one of them.
- What `next_frame` returns is taken as sent; the caller must send it.

The *lease* of what sounds says how soon the next command may go out, and by when the last must be renewed. The device
lets a drive live for one lease after the last fresh frame and orders frames by a sequence of one byte
(firmware/core/lease.c). Hence two bounds:

- *Often enough.* A drive is renewed RENEWALS_PER_LEASE times a lease, so that two lost frames in a row do not end it.
  Silence and waveforms need no renewal for themselves, but the device latches 250 ms after the last fresh frame.
- *Not too often.* A sequence tells newer from older up to 127 frames ahead, so no more may go out within a lease.
"""

from firmware_link.host.clock import DeviceClock
from firmware_link.host.link_values import LinkCounters
from firmware_link.protocol import messages
from firmware_link.protocol.basis import EncodedClick
from firmware_link.protocol.framing import FrameEncoder, encode_frame
from firmware_link.protocol.link_errors import LinkError
from firmware_link.protocol.player import Player

NS_PER_MS = 1_000_000
US_PER_MS = 1_000
# A sequence says its age up to here: with more frames within a lease, old ones could not be told from new ones.
LONGEST_SEQUENCE_LEAD = 127
RENEWALS_PER_LEASE = 3  # each costs a frame a lease; see above
SILENT_RENEWAL_NS = 80 * NS_PER_MS  # the device disarms 250 ms after the last fresh frame: two in a row may be lost
NS_PER_US = 1_000
JITTER_US = 2 * NS_PER_MS // NS_PER_US  # a frame may reach the device so much sooner after the one before than it left
_NEVER_NS = (1 << 63) - 1  # the greatest int64


class Lease:
    """Times of the lease that was agreed with the device, in host nanoseconds where not named otherwise."""

    def __init__(self, duration_ms: int) -> None:
        self.duration_ms = duration_ms
        self.duration_us = duration_ms * US_PER_MS
        self.renewal_ns = duration_ms * NS_PER_MS // RENEWALS_PER_LEASE  # between two frames that hold a drive
        self.spacing_ns = -(-duration_ms * NS_PER_MS // LONGEST_SEQUENCE_LEAD)  # between two commands, at least
        self.free_ns = 0  # time from which another command may go out
        self.renewal_due_ns = 0  # time by which what sounds must be renewed


class Outbox:
    """The slot, what sounds, and the lease that holds it; drives are bytes from `encode_drive`."""

    def __init__(self, counters: LinkCounters, slew_limit_per_s: int, encoder: FrameEncoder) -> None:
        self.silent_drive = b""  # zeros for every actuator of the device
        self.lease = Lease(0)
        self.drive_sequence: int | None = None  # of the last new command: STATUS names it once it is applied
        self.holds_clicks = False  # clicks wait, since the device is changing its basis
        self._counters = counters
        self._slew_limit_per_s = slew_limit_per_s
        self._encoder = encoder
        self._clock = DeviceClock()
        self._slot: bytes | EncodedClick | None = None
        self._sounding: bytes | EncodedClick = b""
        self._writes_phase = True
        self._click_end_ns = 0
        self._player = Player()

    def start(self, silent_drive: bytes, lease_ms: int, clock: DeviceClock) -> None:
        """Begin a session in silence, with the agreed lease and the device's clock."""
        self.silent_drive, self.lease, self._clock = silent_drive, Lease(lease_ms), clock
        self.drive_sequence = None
        self.clear()

    def clear(self) -> None:
        """Nothing waits and nothing sounds."""
        self._slot, self._sounding, self._writes_phase = None, self.silent_drive, True
        self._player = Player()
        self.holds_clicks = False

    @property
    def is_waiting(self) -> bool:
        """Whether a command waits."""
        return self._slot is not None

    @property
    def is_silent(self) -> bool:
        """Whether nothing waits and what sounds is silence."""
        return self._slot is None and isinstance(self._sounding, bytes) and not any(self._sounding)

    def put_drive(self, drive: bytes, *, writes_phase: bool = True) -> None:
        """Send this drive next, in place of the command that waits; raises LinkError for a drive that is too long.

        Actuators beyond those of the drive get silence. Without `writes_phase` oscillators that sound run on.
        """
        size = len(self.silent_drive)
        if len(drive) != size:
            if len(drive) > size:
                raise LinkError(f"a drive of {len(drive)} bytes; the device takes {size}")
            drive = drive.ljust(size, b"\0")
        # A renewal of the drive before may still go out with this; it is superseded by the drive that waits.
        self._writes_phase = writes_phase
        self.put(drive)

    def put(self, wanted: bytes | EncodedClick) -> None:
        """Send this next, in place of the command that waits; a drive has as many bytes as `silent_drive`."""
        self._counters.coalesced += self._slot is not None
        self._slot = wanted

    def drop_click(self) -> None:
        """Forget a click that waits."""
        if self._slot is not None and not isinstance(self._slot, bytes):
            self._counters.coalesced += 1
            self._slot = None

    def due_ns(self, now_ns: int) -> int:
        """Time at which `next_frame` has one, perhaps in the past."""
        renewal_due_ns = self.lease.renewal_due_ns
        if self._slot is None:
            return renewal_due_ns
        drive_from_ns, click_from_ns = self.free_from_ns(now_ns)
        return min(renewal_due_ns, drive_from_ns if isinstance(self._slot, bytes) else click_from_ns)

    def next_frame(self, now_ns: int) -> bytes:
        """Frame of the command that waits, or else of the renewal of what sounds, where one is due; empty otherwise."""
        command = self._next_command(now_ns)
        if command is None:
            return self._renewal(now_ns)
        self.drive_sequence = sequence = self._encoder.next_sequence()
        if isinstance(command, bytes):
            reference, lease_ms = self._clock_reference(now_ns), self.lease.duration_ms
            body = messages.encode_set_body(reference, lease_ms, command, sequence, writes_phase=self._writes_phase)
        else:
            body = messages.encode_play_body(self._clock_reference(now_ns), command.play, sequence)
        return encode_frame(body)

    def free_from_ns(self, now_ns: int) -> tuple[int, int]:
        """Times from which a drive, and a click, may go out."""
        free_ns = self.lease.free_ns
        if self.holds_clicks:
            return free_ns, _NEVER_NS
        return free_ns, max(free_ns, self._player.room_us(now_ns // NS_PER_US) * NS_PER_US)

    def _clock_reference(self, now_ns: int) -> int:
        return self._clock.device_time_us(now_ns) // messages.CLOCK_REFERENCE_US % messages.CLOCK_REFERENCE_SPAN

    def _next_command(self, now_ns: int) -> bytes | EncodedClick | None:
        """Take the command that waits, if it may go out now, and let it sound."""
        wanted, lease = self._slot, self.lease
        if wanted is None or now_ns < lease.free_ns:
            return None
        if isinstance(wanted, bytes):
            self._start_drive(wanted, now_ns)
        elif not self._start_click(wanted, now_ns):
            return None
        self._slot = None
        self._counters.sent += 1
        lease.free_ns = now_ns + lease.spacing_ns
        return wanted

    def _renewal(self, now_ns: int) -> bytes:
        """Frame that holds what sounds, if it is due: another SET for a drive, KEEPALIVE for a click."""
        if now_ns < self.lease.renewal_due_ns:
            return b""
        reference, sounding = self._clock_reference(now_ns), self._sounding
        if not isinstance(sounding, bytes):
            if now_ns < self._click_end_ns:
                self._counters.kept_alive += 1
                self.lease.renewal_due_ns = min(now_ns + SILENT_RENEWAL_NS, self._click_end_ns)
                assert self.drive_sequence is not None  # a click sounds only after its PLAY
                return self._encoder.encode(messages.KeepAlive(reference, self.drive_sequence))
            sounding = self.silent_drive
        self._counters.renewed += 1
        self._start_drive(sounding, now_ns)
        sequence, lease_ms = self._encoder.next_sequence(), self.lease.duration_ms
        return encode_frame(
            messages.encode_set_body(reference, lease_ms, sounding, sequence, writes_phase=self._writes_phase)
        )

    def _start_drive(self, drive: bytes, now_ns: int) -> None:
        if self._player.end_us is not None:
            self._player.take_over(now_ns // NS_PER_US, self._slew_limit_per_s, JITTER_US)
        lease = self.lease
        self._sounding = drive
        lease.renewal_due_ns = now_ns + (lease.renewal_ns if drive != self.silent_drive else SILENT_RENEWAL_NS)

    def _start_click(self, wanted: EncodedClick, now_ns: int) -> bool:
        """Let a click sound; False where it must wait."""
        player, now_us = self._player, now_ns // NS_PER_US
        if self.holds_clicks:
            return False
        if player.end_us is not None and player.end_us <= now_us:
            player.finish()
        # Most touches find nothing that plays or fades, and skip the look at the times.
        if player.end_us is not None or player.fade_ends_us:
            if not player.has_room(now_us):
                return False
            player.take_over(now_us, self._slew_limit_per_s, JITTER_US)
        # The device plays from when the frame comes, at most one lease later: a SET before that end would cut it.
        length_us = wanted.length_us + self.lease.duration_us
        player.start(now_us, length_us, wanted.amplitude)
        self._sounding = wanted
        self._click_end_ns = now_ns + length_us * NS_PER_US
        self.lease.renewal_due_ns = min(now_ns + SILENT_RENEWAL_NS, self._click_end_ns)
        return True
