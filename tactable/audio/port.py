"""A sound card behind the interface of a serial port, and the one function that opens a port of either kind."""

import socket

from base.child import START_TIMEOUT_S, Child, ChildError
from firmware_link.host.descriptor_port import DescriptorPort
from firmware_link.host.serial_port import SerialPort
from tactable.audio.names import AudioError, is_audio, parse_output
from tactable.shipped import cache_folder

BIT_RATE_HZ = 8_000_000
"""Bit rate that is told to the link: at this rate the longest frame takes less time than a block of the card."""
_CHILD = "tactable.audio.output_process"


class AudioPort(DescriptorPort):
    """An open sound card. Any failure is a LinkLostError, as after an unplug. Raises AudioError."""

    bit_rate_hz = BIT_RATE_HZ

    def __init__(self, text: str) -> None:
        output = parse_output(text)
        self.path = f"sound card {output.name}" + (" (SIMULATED)" if output.is_simulated else "")
        self._socket, theirs = socket.socketpair()
        with theirs:
            arguments = {"port": text, "wire": theirs.fileno(), "cache": str(cache_folder())}
            self._child = Child(_CHILD, arguments, name=self.path, descriptors=(theirs.fileno(),))
        try:
            greeting = self._child.read(START_TIMEOUT_S)
        except ChildError as error:
            self.close()
            raise AudioError(str(error)) from error
        self.latency_s: float = greeting["latency_s"]
        """Time from a block's callback to the converter, as the driver says."""
        self.notes = (
            f"{self.path}: {output.rate_hz / 1e3:g} kHz, a command waits up to {1e3 * greeting['block_s']:.1f} ms for "
            f"a block and then {1e3 * self.latency_s:.1f} ms in the card, as its driver says; no sample above "
            f"{100 * output.most:g} %",
            "a sound card has no firmware: the lease is kept by a process of this machine, and only a limit in the "
            "amplifier protects the actuators if the machine hangs (docs/safety.md)",
        )
        """What a user should know, one sentence each."""
        super().__init__(self.path, self._socket.fileno())

    def close(self) -> None:
        """Fade, and end the process of the card; a second close does nothing."""
        self._socket.close()
        self._child.end()


OpenPort = SerialPort | AudioPort
"""What a port's name opens."""


def open_port(name: str, bit_rate_hz: int = 115_200) -> OpenPort:
    """The port of this name: a sound card for "audio:...", else a serial port. Raises LinkError."""
    return AudioPort(name) if is_audio(name) else SerialPort(name, bit_rate_hz)
