"""Player: when each waveform ends, from its start and from what takes over from it."""

from firmware_link.protocol.messages import FULL_SCALE_WORD

US_PER_S = 1_000_000
WAVEFORMS_AT_ONCE = 2  # one that plays and one that fades: a device has memory for no more


class Player:
    """Which waveforms sound, by their end times alone; amplitudes are words, times device microseconds."""

    def __init__(self) -> None:
        self.end_us: int | None = None  # when the waveform that plays ends by itself; None while none plays
        self._amplitude = 0
        self.fade_ends_us: list[int] = []  # when each waveform that was taken over has faded

    def has_room(self, now_us: int) -> bool:
        """Whether another waveform may start."""
        return self.room_us(now_us) <= now_us

    def room_us(self, now_us: int) -> int:
        """When another waveform may start: now, or when enough of those that fade have ended."""
        if not self.fade_ends_us:
            return now_us
        fading_us = sorted(end_us for end_us in self.fade_ends_us if end_us > now_us)
        excess = len(fading_us) + (self.end_us is not None) - WAVEFORMS_AT_ONCE
        return now_us if excess < 0 else fading_us[excess]

    def start(self, now_us: int, length_us: int, amplitude: int) -> None:
        """Play a waveform, after `take_over` of the one that played."""
        self.end_us, self._amplitude = now_us + length_us, amplitude

    def take_over(self, now_us: int, slew_per_s: int, margin_us: int = 0) -> None:
        """Let the waveform that plays fade; it may sound for `margin_us` longer than its fade."""
        self.fade_ends_us = [end_us for end_us in self.fade_ends_us if end_us > now_us]
        if self.end_us is not None and self.end_us > now_us:
            fade_us = -(-self._amplitude * US_PER_S // (FULL_SCALE_WORD * slew_per_s))
            self.fade_ends_us.append(min(self.end_us, now_us + fade_us + margin_us))
        self.end_us = None

    def finish(self) -> None:
        """Note that the waveform that plays has ended."""
        self.end_us = None
