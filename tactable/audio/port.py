"""A sound card behind the interface of a serial port, and the one function that opens a port of either kind."""

import socket
from collections.abc import Callable
from typing import Self

from base.child import START_TIMEOUT_S, Child, ChildError
from firmware_link import BIT_RATE_HZ
from firmware_link.host.serial_port import DescriptorPort, SerialPort
from firmware_link.protocol.link_errors import LinkLostError
from tactable.audio.names import AudioError, is_audio, parse_output
from tactable.shipped import cache_folder

CARD_BIT_RATE_HZ = 8_000_000  # told to the link: the longest frame takes less time than a block of the card
_CHILD = "tactable.audio.output_process"


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
