"""A sound card as the converter of a sensor: its process, and the stream of samples that it writes."""

import os
from pathlib import Path

from base.child import START_TIMEOUT_S, Child, ChildError
from engine.device import Device
from tactable.audio.names import parse_input
from tactable.measure.sample_stream import SampleStream
from tactable.measure.sensor import Block, SensorError

_CHILD = "tactable.measure.audio_process"


class AudioSensor(SampleStream):
    """The samples of a card, named by a text such as "audio:NAME,acceleration=1,scale=98.1 m/s^2,loopback=2".

    Raises AudioError for a text that leaves something open, SensorError for a card that cannot be used.
    """

    def __init__(self, text: str, device: Device) -> None:
        actuators = [actuator.name for actuator in device.actuators]
        source = parse_input(text, actuators)
        reader, writer = os.pipe()
        arguments = {"sensor": text, "actuators": actuators, "pipe": writer}
        self._child = Child(_CHILD, arguments, name=f"sound card {source.name}", descriptors=(writer,))
        os.close(writer)
        try:
            self._child.read(START_TIMEOUT_S)
            super().__init__(Path(f"/proc/self/fd/{reader}"), device)
        except (ChildError, SensorError) as error:
            self._child.end()
            raise SensorError(str(error)) from error
        finally:
            os.close(reader)

    def read(self) -> Block | None:
        """New samples, or None. Raises SensorError when the card is gone."""
        try:
            return super().read()
        except SensorError:
            try:
                self._child.read(START_TIMEOUT_S)
            except ChildError as error:
                raise SensorError(f"{error}: plug the card in and start again") from error
            raise

    def close(self) -> None:
        """End the process of the card."""
        super().close()
        self._child.end()
