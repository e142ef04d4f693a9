"""Streams of samples to and from a sound card, by PortAudio, and a simulated one at the pace of the clock."""

import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from base.arrays import Single
from tactable.audio.interfaces import find_interfaces, load_portaudio, quiet, select_interface
from tactable.audio.names import SIMULATED, AudioError

Samples = Single
Callback = Callable[[Samples, int, bool], None]  # a block (sample, channel), its samples, whether some were lost
_NS_PER_S = 1_000_000_000
_LOOK_S, _MOST_IDLE = 0.1, 5


def wait_while_called(asked_to_end: Callable[[float], bool], blocks: Callable[[], int], name: str) -> None:
    """Wait until `asked_to_end`, which takes a patience in seconds; `blocks`: how often the card has called back.

    Raises AudioError where it calls back no more, which is all that PortAudio does after an unplug. A card asks every
    20 ms at most; looks are counted and not time, since a process that was stopped has seen no card stop.
    """
    before, idle = -1, 0
    while not asked_to_end(_LOOK_S):
        now = blocks()
        before, idle = now, idle + 1 if now == before else 0
        if idle == _MOST_IDLE:
            raise AudioError(f"{name} takes and gives no more samples, as after an unplug: plug it in again")


class PortAudioStream:
    """A stream in one direction, float32, of a card; `name`: the whole of its name. Raises AudioError.

    With `is_input` it hands what it records to `callback`, which otherwise fills in what is played.
    """

    def __init__(
        self, name: str, channels: int, rate_hz: int, block: int, callback: Callback, *, is_input: bool, is_exact: bool
    ) -> None:
        module = load_portaudio()
        card = select_interface(name, find_interfaces(module), is_input=is_input, is_exact=is_exact)
        most = card.inputs if is_input else card.outputs
        if channels > most:
            what = "inputs" if is_input else "outputs"
            raise AudioError(f"{card.name}: has {most} {what}, channel {channels} is asked for; choose another channel")
        self.name = card.name

        def called(data: Samples, frames: int, _: Any, status: Any) -> None:
            callback(data, frames, bool(status.input_overflow if is_input else status.output_underflow))

        make, latency = (module.InputStream, "high") if is_input else (module.OutputStream, "low")
        try:
            with quiet():
                form = {"samplerate": rate_hz, "blocksize": block, "device": card.index, "channels": channels}
                self._stream = make(**form, dtype="float32", latency=latency, callback=called)
        except module.PortAudioError as error:
            raise AudioError(
                f"{card.name}: does not open at {rate_hz} Hz ({error}); close other programs that use it, or take "
                "another rate"
            ) from error

    @property
    def latency_s(self) -> float:
        """Time from the callback to the converter or back, as the driver says."""
        return float(self._stream.latency)

    def start(self) -> None:
        """Call back from now on, in a thread of the stream."""
        self._stream.start()

    def stop(self) -> None:
        """Play what was handed over, and call back no more."""
        self._stream.stop()
        self._stream.close()


class SimulatedStream:
    """A card that is not there: it asks for a block whenever one of two has been played, and hears nothing. SIMULATED.

    A block that comes later than that is a gap, as with a real card.
    """

    name = SIMULATED

    def __init__(self, channels: int, rate_hz: int, block: int, callback: Callback) -> None:
        self._shape, self._block_ns, self._callback = (block, channels), block * _NS_PER_S // rate_hz, callback
        self._has_ended = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    @property
    def latency_s(self) -> float:
        """Two blocks."""
        return 2 * self._block_ns / _NS_PER_S

    def start(self) -> None:
        """Call back from now on."""
        self._thread.start()

    def stop(self) -> None:
        """Call back no more."""
        self._has_ended.set()
        self._thread.join()

    def _run(self) -> None:
        due_ns = time.monotonic_ns()
        while not self._has_ended.wait(max(0.0, (due_ns - time.monotonic_ns()) / _NS_PER_S)):
            ran_dry = time.monotonic_ns() > due_ns + 2 * self._block_ns
            if ran_dry:
                due_ns = time.monotonic_ns()
            self._callback(np.zeros(self._shape, np.float32), self._shape[0], ran_dry)
            due_ns += self._block_ns
