"""A sound card in virtual time: it asks the real board for its blocks, and plays them late, on a clock of its own.

It is used where an emulated firmware is: bytes in, bytes out, and the next time at which something happens. SIMULATED.
"""

import ctypes
import math
from dataclasses import dataclass

import numpy as np

from base.arrays import Array
from tactable.audio.board import AudioBoard, CardPace
from tactable.audio.names import AudioOutput

_US_PER_S = 1_000_000


@dataclass(frozen=True)
class CardFlaws:
    """The flaws of a card's output.

    latency_s: from a block's callback to its first sample at the output. drift: pace of its clock over the host's, less
    1. jitter_s: how late a callback comes at most, less than the latency or the card runs dry.
    gaps_per_s: how often a callback comes gap_s too late.
    """

    latency_s: float = 0.010
    drift: float = 0.0
    jitter_s: float = 0.0
    gaps_per_s: float = 0.0
    gap_s: float = 0.02


class SimulatedCard:
    """One card from its start at time 0. `drive` has what it has played so far."""

    def __init__(
        self, library: ctypes.CDLL, output: AudioOutput, flaws: CardFlaws | None = None, seed: int = 0
    ) -> None:
        self.output = output
        self.board = AudioBoard(library, output, 0x5EED + seed)
        self.gaps = 0  # blocks that came too late
        self._flaws, self._random = flaws or CardFlaws(), np.random.default_rng(seed)
        self._pace = CardPace(output.rate_hz)
        self._period_us = output.block / output.rate_hz * _US_PER_S / (1 + self._flaws.drift)
        self._due_us = self._late_us = 0.0
        self._stall_us = 0
        self._waiting = b""
        self._played: list[Array] = []
        self._kept = 0  # samples of the card before the first in `_played`

    def stall(self, duration_us: int) -> None:
        """Let the program that feeds the card stand still from its next callback on."""
        self._stall_us = duration_us

    def receive(self, data: bytes, now_us: int) -> bytes:
        """Take bytes that came at this time; they wait for the next block."""
        said = self.run_until(now_us)
        self._waiting += data
        return said

    def run_until(self, now_us: int) -> bytes:
        """Run every callback up to this time; what the board says."""
        said = b""
        while self._callback_us() <= now_us:
            said += self._call_back()
        return said

    def next_deadline_us(self) -> int:
        """Time at which the next block is asked for."""
        return math.ceil(self._callback_us())

    def drive(self, start_us: float, stop_us: float, rate_hz: float) -> Array:
        """Samples (time, actuator) at the output, on the grid n / rate_hz from time 0, straight lines between."""
        first, stop = (math.ceil(time_us * rate_hz / _US_PER_S) for time_us in (start_us, stop_us))
        own_hz = self.output.rate_hz * (1 + self._flaws.drift)
        at = (np.arange(first, stop) / rate_hz - self._flaws.latency_s) * own_hz - self._kept
        played = np.concatenate(self._played) if self._played else np.zeros((1, len(self.output.channels)))
        self._played = [played]
        columns = [np.interp(at, np.arange(len(played)), column, left=0.0, right=0.0) for column in played.T]
        return np.column_stack(columns)

    def forget(self, before_us: float) -> None:
        """Drop what was played before this time."""
        own_hz = self.output.rate_hz * (1 + self._flaws.drift)
        before = int((before_us / _US_PER_S - self._flaws.latency_s) * own_hz) - 1 - self._kept
        if before > 0 and self._played:
            played = np.concatenate(self._played)
            self._played = [played[before:]]
            self._kept += min(before, len(played))

    def _callback_us(self) -> float:
        return self._due_us + self._late_us + self._stall_us

    def _call_back(self) -> bytes:
        now_us, lost, flaws, output = self._callback_us(), 0, self._flaws, self.output
        ran_dry = now_us > self._due_us + flaws.latency_s * _US_PER_S
        if ran_dry:
            # The card has played silence, and asks again as if it had just been started.
            silent = round((now_us - self._due_us) / _US_PER_S * output.rate_hz * (1 + flaws.drift))
            self._played.append(np.zeros((silent, len(output.channels))))
            self._due_us, self._late_us, self._stall_us = now_us, 0.0, 0
            self.gaps += 1
        lost = self._pace.lost(round(1000 * now_us), output.block, ran_dry=ran_dry)
        samples, said = self.board.render(self._waiting, output.block, lost)
        self._waiting, self._stall_us = b"", 0
        self._played.append(samples.astype(np.float64))
        self._due_us += self._period_us
        self._late_us = flaws.jitter_s * self._random.random() * _US_PER_S
        if self._random.random() < flaws.gaps_per_s * self._period_us / _US_PER_S:
            self._late_us += (flaws.latency_s + flaws.gap_s) * _US_PER_S
        return said
