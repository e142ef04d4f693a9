"""Port and clock of a simulated board in virtual time: time passes only in `wait`. SIMULATED."""

import select
from collections.abc import Sequence

from firmware_link.emulator.firmware import EmulatedFirmware
from tactable.audio.simulated_card import SimulatedCard
from tactable.rig.accelerometer import SensedBoard

PORT, SENSOR = -1, -2  # stand-ins for descriptors
_LINE_NS = 300_000  # between USB of high and of full speed (0.15 and 1 ms)
_NS_PER_S = 1_000_000_000


Board = EmulatedFirmware | SensedBoard | SimulatedCard  # a board without a line; times are microseconds of its own


class VirtualLine:
    """A board behind a line that takes _LINE_NS either way; what else wakes a wait is for its subclasses."""

    def __init__(self, board: Board) -> None:
        self.time_ns = _NS_PER_S
        self._board = board
        self._to_device: list[tuple[int, bytes]] = []
        self._to_host: list[tuple[int, bytes]] = []
        self._stall_ns = 0

    def stall(self, duration_ns: int) -> None:
        """Let the host stand still for a while at its next wait."""
        self._stall_ns = duration_ns

    def now_ns(self) -> int:
        """Virtual time."""
        return self.time_ns

    def wait(self, until_ns: int | None, readable: Sequence[int], writable: Sequence[int]) -> Sequence[int]:  # noqa: ARG002  # a Clock
        """Let time pass until one of `readable` can be read, or until then."""
        end_ns = self.time_ns + _NS_PER_S if until_ns is None else until_ns
        if self._stall_ns:
            self.run_to(self.time_ns + self._stall_ns)
            self._stall_ns = 0
        while not (ready := self._ready_of(readable)) and self.time_ns < end_ns:
            self.run_to(min(end_ns, self._next_ns(readable)))
        return ready

    def fileno(self) -> int:
        """Stand-in for the port's descriptor."""
        return PORT

    def write(self, data: bytes) -> int:
        """Bytes for the firmware."""
        self._to_device.append((self.time_ns + _LINE_NS, data))
        return len(data)

    def read(self) -> bytes:
        """Bytes of the firmware."""
        data = b"".join(data for time_ns, data in self._to_host if time_ns <= self.time_ns)
        self._to_host = [item for item in self._to_host if item[0] > self.time_ns]
        return data

    def run_to(self, end_ns: int) -> None:
        """Let time pass."""
        while self._to_device and self._to_device[0][0] <= end_ns:
            time_ns, data = self._to_device.pop(0)
            self._answer(self._board.receive(data, time_ns // 1000), time_ns)
        self._answer(self._board.run_until(end_ns // 1000), end_ns)
        self.time_ns = end_ns

    def _answer(self, data: bytes, time_ns: int) -> None:
        if data:
            self._to_host.append((time_ns + _LINE_NS, data))

    def _ready_of(self, readable: Sequence[int]) -> list[int]:
        """The stand-in of the port where something has come, and every real descriptor that can be read."""
        found = [PORT] if any(time_ns <= self.time_ns for time_ns, _ in self._to_host) else []
        real = [descriptor for descriptor in readable if descriptor >= 0]
        if real:
            found += select.select(real, [], [], 0)[0]
        return [descriptor for descriptor in found if descriptor in readable]

    def _next_ns(self, readable: Sequence[int]) -> int:  # noqa: ARG002  # for subclasses
        """Time at which a byte arrives or the board acts by itself next."""
        times_ns = [time_ns for time_ns, _ in (*self._to_device, *self._to_host)]
        deadline_us = self._board.next_deadline_us()
        if deadline_us is not None:
            times_ns.append(1000 * deadline_us)
        return max(self.time_ns + 1, min(times_ns, default=self.time_ns + _NS_PER_S))
