"""The fast path in virtual time: the compiled decision itself, on reports of a recording and a virtual line."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

from engine.loop.fast.fast_layout import NONE
from engine.loop.fast.fast_path import FastPath
from engine.touch.sources.recording import Playback

if TYPE_CHECKING:
    from tests.tools.virtual import VirtualLine

_HEAD = struct.Struct("<qq")


class Packets(Playback):
    """A playback whose reports the compiled step may read, each behind its time."""

    packet_head = _HEAD.size

    def packet_fileno(self) -> int:
        return -1

    def next_packet(self, now_ns: int) -> bytes:
        report = super().read(now_ns)
        return b"" if report is None else _HEAD.pack(self.report_time_ns, 0) + report

    def has_packet(self, now_ns: int) -> bool:
        due_ns = self.next_time_ns()
        return due_ns is not None and due_ns <= now_ns

    def take_packet(self, packet: bytes, now_ns: int, *, is_last: bool) -> bytes:
        assert is_last is False or not self.has_packet(now_ns)
        return packet[_HEAD.size :]


class VirtualFastPath(FastPath):
    """Waits as the line does, and writes to it."""

    _clock: VirtualLine
    _packets: Packets

    def _run(self, until_ns: int) -> None:
        fast, line = self._moment.fast, self._clock
        fast.packet_size = fast.frame_size = fast.written = 0
        line.wait(None if until_ns == NONE else until_ns, (-1,) if line.is_open else (), ())
        now_ns = fast.read_ns = fast.written_ns = line.now_ns()
        fast.readable[:] = (1,) * len(fast.readable)
        packet = self._packets.next_packet(now_ns)
        fast.packet_size = len(packet)
        fast.packet[: len(packet)] = packet
        self._library.fast_set_time(now_ns)
        if packet and fast.can_answer and self._library.fast_answer(self._moment.address):
            if self._packets.has_packet(now_ns):
                fast.frame_size = 0
            else:
                fast.written = line.write(bytes(fast.frame[: fast.frame_size]))
        self._library.fast_set_time(NONE)
