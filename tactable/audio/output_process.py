"""Child process that feeds a sound card: the bytes of a link from a socket, samples to the card.

It is a process of its own since its samples come from a callback: a thread beside the render loop would cost the loop
10 ms, and a stall of the loop would starve the card. Here a stall of the loop ends the lease, and the drive fades.
"""

import contextlib
import gc
import os
import socket
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from base.child import Parent
from base.printable import write_note
from tactable.audio.board import AudioBoard, CardPace, Samples, core_library
from tactable.audio.names import AudioError, AudioOutput, parse_output
from tactable.audio.streams import PortAudioStream, SimulatedStream, wait_while_called

_READ_SIZE = 1 << 16
_FADING_S = 1.0


class Feeder:
    """The callback: takes what the link has sent, hands the card its samples, and answers. Counts blocks too late."""

    def __init__(
        self, board: AudioBoard, output: AudioOutput, wire: socket.socket, monotonic_ns: Callable[[], int]
    ) -> None:
        self.blocks = self.gaps = 0  # blocks that the card has asked for, and those that came too late
        self.is_silent = threading.Event()  # set once the host is gone and all is silent
        self._board, self._channels, self._wire = board, list(output.channels), wire
        self._pace, self._monotonic_ns = CardPace(output.rate_hz), monotonic_ns
        self._has_host = True
        wire.setblocking(False)

    def feed(self, out: Samples, frames: int, ran_dry: bool) -> None:
        """Fill a block (sample, channel) of the card."""
        lost = self._pace.lost(self._monotonic_ns(), frames, ran_dry=ran_dry)
        self.blocks, self.gaps = self.blocks + 1, self.gaps + ran_dry
        samples, said = self._board.render(self._receive(), frames, lost)
        out[:] = 0
        out[:, self._channels] = samples
        if not self._has_host and not samples.any():
            self.is_silent.set()
        if said:
            with contextlib.suppress(OSError):  # a host that reads nothing loses what the board says, as on a wire
                self._wire.send(said)

    def _receive(self) -> bytes:
        try:
            data = self._wire.recv(_READ_SIZE)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self._board.hang_up()
            self._has_host = False
        return data


def main(parent: Parent, arguments: dict[str, Any]) -> None:
    """Feed the card until the parent asks for the end; the first line says what the card does."""
    output = parse_output(arguments["port"])
    boot_id = int.from_bytes(os.urandom(4), "little")
    wire = socket.socket(fileno=arguments["wire"])
    board = AudioBoard(core_library(Path(arguments["cache"])), output, boot_id)
    feeder = Feeder(board, output, wire, time.monotonic_ns)
    # A collection that meets a callback is a gap; the callback makes no cycles.
    gc.collect()
    gc.freeze()
    gc.disable()
    card, form = arguments["card"], (max(output.channels) + 1, output.rate_hz, output.block, feeder.feed)
    stream: PortAudioStream | SimulatedStream = (
        SimulatedStream(*form)
        if output.is_simulated
        else PortAudioStream(card or output.name, *form, is_input=False, is_exact=card is not None)
    )
    try:
        stream.start()
    except Exception as error:
        raise AudioError(f"{output.name}: cannot be started: {error}") from error
    parent.say({"card": stream.name, "latency_s": stream.latency_s, "block_s": output.block / output.rate_hz})
    try:
        wait_while_called(parent.has_spoken, lambda: feeder.blocks, stream.name)
    except AudioError:
        wire.shutdown(socket.SHUT_RDWR)  # the loop hears of it at once, and PortAudio may never end
        raise
    feeder.is_silent.wait(_FADING_S)
    stream.stop()
    if feeder.gaps:
        write_note(
            f"{output.name}: {feeder.gaps} blocks came too late, and were silence; take a longer block, or a machine "
            "that does less beside it"
        )
