"""A sound card behind the interface of a serial port, and the one function that opens a port of either kind.

A child process feeds the card: the bytes of a link from a socket, samples to the card. It is a process of its own since
its samples come from a callback: a thread beside the render loop would cost the loop 10 ms, and a stall of the loop
would starve the card. Here a stall of the loop ends the lease, and the drive fades.
"""

import contextlib
import gc
import os
import socket
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Self

from base.child import START_TIMEOUT_S, Child, ChildError, Parent
from base.printable import write_note
from firmware_link import BIT_RATE_HZ
from firmware_link.host.serial_port import DescriptorPort, SerialPort
from firmware_link.protocol.link_errors import LinkLostError
from tactable.audio.board import AudioBoard, CardPace, Samples, core_library
from tactable.audio.names import AudioError, AudioOutput, is_audio, parse_output
from tactable.audio.streams import PortAudioStream, SimulatedStream, wait_while_called
from tactable.shipped import cache_folder

CARD_BIT_RATE_HZ = 8_000_000  # told to the link: the longest frame takes less time than a block of the card
_CHILD = "tactable.audio.port"
_READ_SIZE = 1 << 16
_FADING_S = 1.0


class AudioPort(DescriptorPort):
    """A sound card, once it was greeted. Any failure is a LinkLostError, as after an unplug. Raises AudioError.

    card: the whole name of the card, where the one that was open before is opened again.
    """

    bit_rate_hz = CARD_BIT_RATE_HZ

    def __init__(self, text: str, card: str | None = None) -> None:
        self._text, self._output, self.card = text, parse_output(text), card
        self._socket, theirs = socket.socketpair()
        with theirs:
            arguments = {"port": text, "card": card, "wire": theirs.fileno(), "cache": str(cache_folder())}
            name = f"sound card {card or self._output.name}"
            self._child = Child(_CHILD, arguments, name=name, descriptors=(theirs.fileno(),))
        super().__init__(name, self._socket.fileno())

    def has_answered(self) -> bool:
        """Whether `greet` would not wait."""
        return self._child.has_spoken()

    def greet(self) -> Self:
        """Wait until the card plays. Raises AudioError."""
        output = self._output
        try:
            greeting = self._child.read(START_TIMEOUT_S)
        except ChildError as error:
            self.close()
            raise AudioError(str(error)) from error
        self.card = greeting["card"]
        self.path = f"sound card {self.card}" + (" (SIMULATED)" if output.is_simulated else "")
        self.latency_s: float = greeting["latency_s"]  # from a block's callback to the converter, says the driver
        self.notes = (
            f"{self.path}: {output.rate_hz / 1e3:g} kHz, a command waits up to {1e3 * greeting['block_s']:.1f} ms for "
            f"a block and then {1e3 * self.latency_s:.1f} ms in the card, as its driver says; no sample above "
            f"{100 * output.most:g} %",
            "a sound card has no firmware: the lease is kept by a process of this machine, and only a limit in the "
            "amplifier protects the actuators if the machine hangs (docs/safety.md)",
        )
        """What a user should know, one sentence each."""
        return self

    def another(self) -> "AudioPort":
        """The same card, opened again and not yet greeted."""
        return AudioPort(self._text, self.card)

    def _gone(self, reason: object) -> LinkLostError:
        self._child.kill()  # it has no card to fade, and PortAudio may never end
        return super()._gone(reason)

    def close(self) -> None:
        """Fade, and end the process of the card; a second close does nothing."""
        self._socket.close()
        self._child.end()


class CardReopening:
    """Opens a card again. Each call returns at once or raises AudioError: a process takes a second to start."""

    def __init__(self, start: Callable[[], AudioPort]) -> None:
        self._start = start
        self._started: AudioPort | None = None

    def __call__(self) -> AudioPort:
        """The card, where the process that an earlier call started says that it plays."""
        port = self._started = self._started or self._start()
        if not port.has_answered():
            raise AudioError(f"{port.path} does not play yet")
        self._started = None
        return port.greet()

    def close(self) -> None:
        """End a process that was not waited for."""
        if self._started is not None:
            self._started.close()


OpenPort = SerialPort | AudioPort  # what a port's name opens


def open_port(name: str, bit_rate_hz: int = BIT_RATE_HZ) -> OpenPort:
    """The port of this name: a sound card for "audio:...", else a serial port. Raises LinkError."""
    return AudioPort(name).greet() if is_audio(name) else SerialPort(name, bit_rate_hz)


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
