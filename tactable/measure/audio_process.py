"""Child process that reads a sound card and writes its samples into a pipe, in the declared form of all sensors.

It is a process of its own since a callback must not wait for the computing of a measurement. What the card lost, and
what the pipe had no room for while the measurement read nothing, is marked by NaN.
"""

import contextlib
import fcntl
import os
import time
from pathlib import Path
from typing import Any

import numpy as np

from base.child import START_TIMEOUT_S, Child, ChildError, Parent
from engine.device import Device
from tactable.audio.board import CardPace
from tactable.audio.names import AudioError, AudioInput, parse_input
from tactable.audio.streams import PortAudioStream, Samples, wait_while_called
from tactable.measure.sensor import ACCELERATION, LOOPBACK, Block, SampleStream, SensorError, SensorForm, write_header

_BLOCK_S = 0.01  # of a callback; loopback takes the latency out
_PIPE_SIZE = 1 << 20  # fs.pipe-max-size of Linux: 2.7 s of two channels at 48 kHz
_LONGEST_LOSS_S = 1.0


class Taker:
    """The callback: picks channels, scales them to the units of the form, and writes them into a pipe."""

    def __init__(self, source: AudioInput, actuators: list[str], pipe: int) -> None:
        self.form = form_of(source, actuators)
        repeats = len(actuators) if len(source.loopbacks) == 1 else 1
        loopbacks = repeats * source.loopbacks
        self._columns = [source.acceleration, *loopbacks, *(channel for _, channel, _ in source.further)]
        self._scales = np.array(self.form.clips_at, np.float32)  # a sample of 1 is the end
        self._pipe, self._pace = pipe, CardPace(source.rate_hz)
        self._longest = round(_LONGEST_LOSS_S * source.rate_hz)
        self._unwritten = write_header(self.form)
        self._was_full = False
        self.blocks = 0  # blocks that have come
        os.set_blocking(pipe, False)
        with contextlib.suppress(OSError):  # a user may be allowed less
            fcntl.fcntl(pipe, fcntl.F_SETPIPE_SZ, _PIPE_SIZE)

    def take_block(self, data: Samples, frames: int, overflowed: bool) -> None:
        """Take a block (sample, channel) of the card."""
        self.blocks += 1
        lost = min(self._pace.lost(time.monotonic_ns(), frames, ran_dry=overflowed), self._longest)
        self._write()
        if self._unwritten:  # the measurement reads nothing: this block is lost
            self._was_full = True
            return
        # One mark is enough there: it says that the samples beside it do not follow each other.
        marks = max(lost, int(overflowed), int(self._was_full))
        self._was_full = False
        marked = np.full((marks, len(self._columns)), np.nan, np.float32)
        self._unwritten = np.vstack([marked, data[:, self._columns] * self._scales]).astype("<f4").tobytes()
        self._write()

    def _write(self) -> None:
        with contextlib.suppress(BlockingIOError):
            while self._unwritten:
                self._unwritten = self._unwritten[os.write(self._pipe, self._unwritten) :]


def form_of(source: AudioInput, actuators: list[str]) -> SensorForm:
    """The form of the samples of a card; a loopback that has all outputs is that of every actuator."""
    loopbacks = tuple(LOOPBACK + name for name in actuators) if source.loopbacks else ()
    clips_at = (source.scale_m_per_s2, *[source.loopback_scale] * len(loopbacks), *(each[2] for each in source.further))
    channels = (ACCELERATION, *loopbacks, *(name for name, _, _ in source.further))
    return SensorForm(source.rate_hz, channels, clips_at, source.is_simulated)


def main(parent: Parent, arguments: dict[str, Any]) -> None:
    """Read the card until the parent asks for the end; the first line says that it runs."""
    source = parse_input(arguments["sensor"], arguments["actuators"])
    taker = Taker(source, arguments["actuators"], arguments["pipe"])
    channels = max(source.acceleration, *source.loopbacks, *(channel for _, channel, _ in source.further), 0) + 1
    block = round(_BLOCK_S * source.rate_hz)
    stream = PortAudioStream(
        source.name, channels, source.rate_hz, block, taker.take_block, is_input=True, is_exact=False
    )
    try:
        stream.start()
    except Exception as error:
        raise AudioError(f"{source.name}: cannot be started: {error}") from error
    parent.say({"latency_s": stream.latency_s})
    wait_while_called(parent.has_spoken, lambda: taker.blocks, stream.name)
    stream.stop()


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
