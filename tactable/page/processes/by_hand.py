"""Holds the drive that a person asks for on the page, by the same link as a run: a process that hangs falls silent."""

from collections.abc import Callable

from engine.device import Device
from engine.loop import Clock, connect
from engine.render import clamp, link_configuration
from firmware_link.host.link import Link
from firmware_link.host.link_values import LinkState
from firmware_link.host.session import Port, Session
from firmware_link.protocol.messages import encode_drive
from tactable.page.hand import HandDrive


class DrivenByHand:
    """One armed device. Raises LinkError where no fitting device answers."""

    def __init__(self, device: Device, port: Port, clock: Clock, bit_rate_hz: int) -> None:
        self._device, self._clock = device, clock
        self._session = Session(Link(link_configuration(device, bit_rate_hz)), port, clock.now_ns)
        self._capabilities = connect(self._session, clock)

    def hold(self, hand: HandDrive, is_over: Callable[[], bool], watched: int) -> None:
        """Hold a drive until it is over, which a descriptor that can be read may say. Raises LinkError.

        A device that stopped itself, as it does when this machine stalls, is armed again.
        """
        session, clock = self._session, self._clock
        channels = clamp(hand, self._device).channels
        drive = encode_drive(channels, self._capabilities.frequency_resolution_hz)
        session.link.set_drive(drive)
        while not is_over():
            session.send()
            port = session.port.fileno()
            writable = (port,) if session.wants_to_write() else ()
            clock.wait(session.link.next_deadline_ns(), (port, watched), writable)
            session.receive()
            if session.link.state is not LinkState.READY:
                connect(session, clock)
                session.link.set_drive(drive)
