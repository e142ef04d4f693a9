"""What the host wants to sound to the SET, PLAY and KEEPALIVE that bring it and hold it."""

from collections.abc import Callable
from typing import NamedTuple

from firmware_link.host.link_values import LinkCounters
from firmware_link.protocol.line_rate import LONGEST_SEQUENCE_LEAD
from firmware_link.protocol.messages import KeepAlive, Set, SetFlag
from firmware_link.protocol.player import Player

NS_PER_MS = 1_000_000
NS_PER_US = 1_000
US_PER_MS = 1_000
# The device disarms 250 ms after the last fresh frame: two in a row may be lost.
SILENT_RENEWAL_NS = 80 * NS_PER_MS
RENEWALS_PER_LEASE = 3
# A frame may reach the device so much sooner after the one before than it left.
JITTER_US = 2_000
_NEVER_NS = (1 << 63) - 1
# The hot path: without the search in the class.
_WRITE_PHASE = SetFlag.WRITE_PHASE


class WantedDrive(NamedTuple):
    """A drive from `encode_drive`."""

    drive: bytes


class WantedWaveform(NamedTuple):
    """A waveform of the bank; its amplitude is a word."""

    waveform: int
    amplitude: int
    length_us: int


class Outbox:
    """One slot for what comes next, the latest wins, and what was sent last until something replaces it."""

    def __init__(self, counters: LinkCounters, slew_limit_per_s: int) -> None:
        self.silent_drive = b""
        """Zeros for every actuator of the device."""
        self._counters = counters
        self._slew_limit_per_s = slew_limit_per_s
        self.lease_ms = self._lease_us = self._spacing_ns = self._renewal_ns = 0
        self._slot: WantedDrive | WantedWaveform | None = None
        self._sounding = self._silence = WantedDrive(b"")
        self._player = Player()
        self._play_end_ns: int | None = None
        self.holds_waveforms = False
        """Waveforms wait: the bank is being changed."""
        self._renewal_due_ns = 0
        self._spaced_ns = 0

    def start(self, silent_drive: bytes, lease_ms: int) -> None:
        """Begin a session, in silence."""
        self.silent_drive, self.lease_ms = silent_drive, lease_ms
        self._lease_us = lease_ms * US_PER_MS
        self._renewal_ns = lease_ms * NS_PER_MS // RENEWALS_PER_LEASE
        self._spacing_ns = -(-lease_ms * NS_PER_MS // LONGEST_SEQUENCE_LEAD)
        self.clear()

    def clear(self) -> None:
        """Nothing waits and nothing sounds."""
        self._silence = WantedDrive(self.silent_drive)
        self._slot, self._sounding, self._play_end_ns = None, self._silence, None
        self._player = Player()
        self.holds_waveforms = False

    @property
    def is_silent(self) -> bool:
        """Whether nothing waits and nothing is held."""
        return self._slot is None and self._play_end_ns is None and not any(self._sounding.drive)

    def put(self, wanted: WantedDrive | WantedWaveform) -> None:
        """Send this next, in place of what waits."""
        self._counters.coalesced += self._slot is not None
        self._slot = wanted

    def renew_at(self, now_ns: int) -> None:
        """Hold what sounds from now on."""
        self._renewal_due_ns = now_ns

    def due_ns(self, now_ns: int) -> int:
        """When `next_message` has one, perhaps in the past."""
        return min(self._renewal_due_ns, self._slot_due_ns(now_ns))

    def next_command(self, now_ns: int) -> WantedDrive | WantedWaveform | None:
        """What waits and is due: what most touches bring. A drive that takes over from a waveform is left.

        Where it is None, `next_message` says what to send, if anything.
        """
        wanted = self._slot
        if wanted is None or now_ns < self._spaced_ns:
            return None
        player = self._player
        if isinstance(wanted, WantedDrive):
            if player.end_us is not None:
                return None
            self._sounding, self._play_end_ns = wanted, None
            self._renewal_due_ns = now_ns + (
                self._renewal_ns if wanted.drive != self.silent_drive else SILENT_RENEWAL_NS
            )
        else:
            now_us = now_ns // NS_PER_US
            end_us = player.end_us
            if end_us is not None and end_us <= now_us:
                end_us = player.end_us = None
            is_free = end_us is None and not player.fade_ends_us
            if self.holds_waveforms or not (is_free or self._make_room(player, now_us)):
                return None
            # The device plays from when the frame comes, at most one lease later: a SET before that end would cut it.
            length_us = wanted.length_us + self._lease_us
            player.start(now_us, length_us, wanted.amplitude)
            self._sounding = self._silence
            self._play_end_ns = end_ns = now_ns + length_us * NS_PER_US
            silent_ns = now_ns + SILENT_RENEWAL_NS
            self._renewal_due_ns = silent_ns if silent_ns < end_ns else end_ns
        self._slot = None
        self._counters.sent += 1
        self._spaced_ns = now_ns + self._spacing_ns
        return wanted

    def free_from_ns(self, now_ns: int) -> tuple[int, int] | None:
        """From when on a drive, and a waveform, would be sent at once; None while something waits."""
        if self._slot is not None:
            return None
        if self.holds_waveforms:
            return self._spaced_ns, _NEVER_NS
        return self._spaced_ns, max(self._spaced_ns, self._player.room_us(now_ns // NS_PER_US) * NS_PER_US)

    def _make_room(self, player: Player, now_us: int) -> bool:
        """The waveform before fades from now on; False while too many fade already."""
        if not player.has_room(now_us):
            return False
        player.take_over(now_us, self._slew_limit_per_s, JITTER_US)
        return True

    def next_message(
        self, now_ns: int, clock_reference: Callable[[int], int], sequence: int | None
    ) -> tuple[Set | KeepAlive | None, bool]:
        """What is due now, and whether it is a command and no renewal of the one that went out with `sequence`."""
        wanted = self._slot
        if isinstance(wanted, WantedDrive) and now_ns >= self._spaced_ns:
            self._slot = None
            self._counters.sent += 1
            self._spaced_ns = now_ns + self._spacing_ns
            self._sounding = wanted
            return self._set(now_ns, clock_reference(now_ns)), True
        if now_ns < self._renewal_due_ns:
            return None, False
        if self._play_end_ns is not None and now_ns < self._play_end_ns and sequence is not None:
            self._counters.kept_alive += 1
            self._renewal_due_ns = min(now_ns + SILENT_RENEWAL_NS, self._play_end_ns)
            return KeepAlive(clock_reference(now_ns), sequence), False
        self._counters.renewed += 1
        return self._set(now_ns, clock_reference(now_ns)), False

    def _slot_due_ns(self, now_ns: int) -> int:
        if self._slot is None:
            return self._renewal_due_ns
        if isinstance(self._slot, WantedWaveform):
            if self.holds_waveforms:
                return _NEVER_NS
            return max(self._spaced_ns, self._player.room_us(now_ns // NS_PER_US) * NS_PER_US)
        return self._spaced_ns

    def _set(self, now_ns: int, clock_reference: int) -> Set:
        # Silence is renewed by SET too: had the SET that silenced been lost, anything else might hold the old drive.
        self._take_over(now_ns)
        self._play_end_ns = None
        drive = self._sounding.drive
        is_driving = drive != self.silent_drive
        self._renewal_due_ns = now_ns + (self._renewal_ns if is_driving else SILENT_RENEWAL_NS)
        return Set(clock_reference, _WRITE_PHASE, self.lease_ms, drive)

    def _take_over(self, now_ns: int) -> None:
        if self._player.end_us is not None:
            self._player.take_over(now_ns // NS_PER_US, self._slew_limit_per_s, JITTER_US)
