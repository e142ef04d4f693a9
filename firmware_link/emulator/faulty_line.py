"""One direction of a serial line with seeded, counted faults: bytes in at a time, bytes out later."""

import math
import random
from collections import deque
from dataclasses import dataclass

from firmware_link.emulator.fault_plan import FaultPlan, TimedKind
from firmware_link.protocol.framing import DELIMITER, UART_BITS_PER_BYTE

US_PER_S = 1_000_000
BITS_PER_BYTE = 8
_LONGEST_RUN = 4096  # bytes without a delimiter go on at this length: they are no frame
_LONGEST_CUT = 8
_LONGEST_BURST = 16


@dataclass
class LineCounters:
    """Frames that came in, faults by kind, and frames that went out.

    Once all has arrived, `frames + duplicated = dropped + unheard + lost + delivered`. Of the runs between delimiters
    that were delivered, the `intact` ones were frames as they were sent, the `damaged` ones were not: damage to a
    delimiter makes one run of two frames.
    """

    frames: int = 0
    duplicated: int = 0
    dropped: int = 0
    unheard: int = 0  # frames that a half-open line swallowed
    lost: int = 0  # frames lost on a line that was hung up, or to a device without power
    delivered: int = 0
    flipped_bits: int = 0
    insertions: int = 0
    cuts: int = 0
    bursts: int = 0
    delayed: int = 0  # frames that a stall delayed
    intact: int = 0
    damaged: int = 0


@dataclass(frozen=True)
class _Held:
    """Bytes on their way, and the frame that they were; None for noise and lone delimiters."""

    due_us: int
    data: bytes
    frame: bytes | None


class FaultyLine:
    """Delivers what is pushed, in order, each at its time."""

    def __init__(self, plan: FaultPlan, seed: str, *, can_be_half_open: bool) -> None:
        self.counters = LineCounters()
        self._plan = plan
        self._random = random.Random(seed)
        self._stalls = [fault for fault in plan.timed if fault.kind is TimedKind.STALL]
        half_opens = [fault for fault in plan.timed if fault.kind is TimedKind.HALF_OPEN]
        self._half_opens = half_opens if can_be_half_open else []
        self._partial = b""
        self._held: deque[_Held] = deque()
        self._free_us = 0
        self._bits_to_error = self._next_error()
        self._run = b""

    def push(self, data: bytes, now_us: int) -> None:
        """Take bytes that are written at this end."""
        *frames, self._partial = (self._partial + data).split(DELIMITER)
        for content in frames:
            frame = content + DELIMITER
            if content:
                self._push_frame(frame, now_us)
            else:
                self._hold(frame, None, now_us)
        if len(self._partial) > _LONGEST_RUN:
            self.push_noise(self._partial, now_us)
            self._partial = b""

    def push_noise(self, noise: bytes, now_us: int) -> None:
        """Take bytes that are not frames of the sender."""
        self._hold(noise, None, now_us)

    def next_us(self) -> int | None:
        """Time of the next arrival; None while nothing is on its way."""
        return self._held[0].due_us if self._held else None

    def pop(self, now_us: int) -> bytes:
        """Take what has arrived at the other end."""
        arrived = []
        while self._held and self._held[0].due_us <= now_us:
            held = self._held.popleft()
            arrived.append(held.data)
            self._account(held)
        return b"".join(arrived)

    def lose(self) -> None:
        """Drop everything that is on its way."""
        self.counters.lost += sum(held.frame is not None for held in self._held)
        self._held.clear()
        self._partial = b""

    def forget(self) -> None:
        """Account for a receiver that forgot the part of a frame that it had."""
        self._run = b""

    def _push_frame(self, frame: bytes, now_us: int) -> None:
        counters = self.counters
        counters.frames += 1
        if any(fault.ends_us(now_us) is not None for fault in self._half_opens):
            counters.unheard += 1
        elif self._happens(self._plan.drop):
            counters.dropped += 1
        else:
            self._hold(self._damage(frame), frame, now_us)
            if self._happens(self._plan.duplicate):
                counters.duplicated += 1
                self._hold(self._damage(frame), frame, now_us)

    def _hold(self, data: bytes, frame: bytes | None, now_us: int) -> None:
        plan = self._plan
        due_us = now_us + plan.delay_us + (self._random.randint(0, plan.jitter_us) if plan.jitter_us else 0)
        self.counters.delayed += frame is not None and any(stall.ends_us(due_us) for stall in self._stalls)
        due_us = max(due_us, self._free_us)
        if plan.baud_hz:
            due_us += -(-len(data) * UART_BITS_PER_BYTE * US_PER_S // plan.baud_hz)
        for stall in self._stalls:
            due_us = stall.ends_us(due_us) or due_us
        self._free_us = due_us
        self._held.append(_Held(due_us, data, frame))

    def _damage(self, frame: bytes) -> bytes:
        data = self._flip(frame) if self._plan.bit_errors else frame
        chance = self._random
        if self._happens(self._plan.insert):
            self.counters.insertions += 1
            at = chance.randint(0, len(data))
            data = data[:at] + chance.randbytes(chance.randint(1, _LONGEST_CUT)) + data[at:]
        if self._happens(self._plan.lose):
            self.counters.cuts += 1
            at = chance.randrange(len(data))
            data = data[:at] + data[at + chance.randint(1, _LONGEST_CUT) :]
        if self._happens(self._plan.burst):
            self.counters.bursts += 1
            at = chance.randrange(max(1, len(data) - 1))
            noise = chance.randbytes(min(len(data) - at, chance.randint(2, _LONGEST_BURST)))
            data = data[:at] + noise + data[at + len(noise) :]
        return data

    def _flip(self, frame: bytes) -> bytes:
        bits = BITS_PER_BYTE * len(frame)
        if self._bits_to_error >= bits:
            self._bits_to_error -= bits
            return frame
        data, at = bytearray(frame), self._bits_to_error
        while at < bits:
            data[at // BITS_PER_BYTE] ^= 1 << at % BITS_PER_BYTE
            self.counters.flipped_bits += 1
            at += 1 + self._next_error()
        self._bits_to_error = at - bits
        return bytes(data)

    def _next_error(self) -> int:
        """Draw the number of right bits before the next wrong one."""
        if not 0 < self._plan.bit_errors < 1:
            return 0
        return int(math.log(1.0 - self._random.random()) / math.log1p(-self._plan.bit_errors))

    def _happens(self, probability: float) -> bool:
        return probability > 0 and self._random.random() < probability

    def _account(self, held: _Held) -> None:
        self.counters.delivered += held.frame is not None
        *runs, self._run = (self._run + held.data).split(DELIMITER)
        for run in filter(None, runs):
            if held.frame is not None and run == held.frame[:-1]:
                self.counters.intact += 1
            else:
                self.counters.damaged += 1
