"""A drive by hand in place of a run: the board holds what the sliders of the run's page say, and then the run goes on.

The run has ended with silence and STOP by then, and its port is free. The board is greeted and armed for the amplitude
limit of the device, and once more for the run afterwards. Reports of touches that came meanwhile are left out: a click
for a finger that was there seconds ago would be wrong.
"""

from dataclasses import dataclass

from engine.loop import Clock, StopRequest
from engine.render import clamp
from engine.touch.sources import Source
from firmware_link.host.reopening import ReopeningPort
from firmware_link.host.serial_port import SerialPort
from tactable.audio.port import AudioPort
from tactable.measure.driven_device import DrivenDevice
from tactable.page.asked_by_hand import AskedByHand
from tactable.run.live import Live

OpenPort = SerialPort | AudioPort


@dataclass(frozen=True)
class PageDrive:
    """A board that the page may drive, and who asks."""

    asked: AskedByHand
    live: Live
    reopening: ReopeningPort[OpenPort]
    clock: Clock
    bit_rate_hz: int
    source: Source

    def is_set(self) -> bool:
        """Whether a drive is asked for of a board that is there: that ends the run of the touches."""
        return self.asked.is_set() and self.reopening.port is not None

    def hold(self, stop: StopRequest) -> None:
        """Hold what the page asks for until it asks no more, or `stop` is set. Raises what DrivenDevice raises."""
        port, device, played = self.reopening.port, self.live.device, None
        assert port is not None  # `is_set`
        most = [device.limits.amplitude] * len(device.actuators)
        with DrivenDevice(device, port, self.clock, most, self.bit_rate_hz) as driven:
            self.asked.tell(is_driving=True)
            while not stop.is_set() and (asked := self.asked.drive()) is not None:
                if asked != played:
                    played = asked
                    driven.play(clamp(asked, device))
                driven.wait(self.asked.ends_ns, (self.asked.fileno(),))
        self.asked.tell(is_driving=False)
        while self.source.read(self.clock.now_ns()) is not None:
            pass
