"""A board made of a sound card: bytes of a link in, samples of the card out, block by block.

Theory of operation. The firmware's C core runs on the clock of the card: its time is the number of samples that were
asked of it, so that drives, ramps, phases and clicks are those of every other board, at the rate of the card. Once a
block the card asks for samples; then, and only then, the core takes the bytes that have come and answers.

There is no firmware on the other side of a wire, and so nothing that outlives this machine. What is left of its
guarantees:

- *The lease gates every sample.* The core takes frames of the render loop only, and falls silent by itself 40 ms after
  the last fresh one: a loop that stalls is faded out, whatever this process does. That holds while the card is fed.
- *A block that came too late.* The card has played silence in the meantime, which is a step. The samples that were
  missed are skipped, so that the clock of the core stays that of the card, and the next ones rise from silence.
- *No sample exceeds `most`.* The full scale of the core is `most`, so that nothing that the link can say is greater;
  the samples are clipped there once more.

A machine that hangs as a whole feeds the card nothing; what the card does then is its own affair, and only a limit in
the amplifier protects the actuators (docs/safety.md).
"""

import ctypes
from pathlib import Path

import numpy as np

from base.arrays import Single
from base.c_library import CompileError, LibrarySource, compile_library
from firmware_link.emulator.c_core import CompiledFirmware, open_library
from firmware_link.emulator.device_state import DeviceConfiguration
from firmware_link.host.link_values import BOARD_EMULATED, BOARD_SOUND_CARD
from firmware_link.protocol.basis import SAMPLE_FULL_SCALE
from firmware_link.protocol.messages import PM_PER_M
from tactable.audio.names import AudioError, AudioOutput

Samples = Single

RISE_S = 0.005  # time of the rise from silence after a block that came too late: the ramp of the shipped devices
_FIRMWARE = Path(__file__).parents[2] / "firmware_link" / "firmware"
_FLAGS = ("-std=c99", "-O2", "-fPIC", "-shared", "-DTACTABLE_ACTUATORS=64u")
_US_PER_S = 1_000_000
_LONGEST_SKIP_S = 1.0


def core_library(folder: Path) -> ctypes.CDLL:
    """The firmware's C core, compiled in `folder` at the first call. Raises AudioError without a C compiler."""
    sources = (*sorted((_FIRMWARE / "core").glob("*.c")), _FIRMWARE / "host" / "host.c")
    source = LibrarySource("core", sources, _FLAGS, include=(_FIRMWARE / "core", _FIRMWARE / "host"))
    try:
        return open_library(compile_library(folder, source))
    except CompileError as error:
        raise AudioError(f"a sound card plays by the firmware's C core, which is compiled here: {error}") from error


class AudioBoard:
    """The C core at the rate of a card. Not for two threads at once."""

    def __init__(self, library: ctypes.CDLL, output: AudioOutput, boot_id: int) -> None:
        self._output = output
        full_scales_pm = tuple(round(PM_PER_M * output.most * each_m) for each_m in output.full_scales_m)
        self._core = CompiledFirmware(
            library,
            DeviceConfiguration(
                boot_id,
                len(output.channels),
                full_scales_pm=full_scales_pm,
                synthesis_rate_hz=output.rate_hz,
                board=BOARD_EMULATED if output.is_simulated else BOARD_SOUND_CARD,
            ),
        )
        self._made = 0
        self._rise = max(1, round(RISE_S * output.rate_hz))
        self._risen = self._rise

    @property
    def time_us(self) -> int:
        """Time of the core: the samples that were made, and those that were skipped."""
        return self._made * _US_PER_S // self._output.rate_hz

    def render(self, received: bytes, frames: int, lost: int = 0) -> tuple[Samples, bytes]:
        """The next samples (sample, actuator) of the card, within -most to most, and what the board says.

        lost: samples of silence that the card played since the last call, because this one came too late.
        """
        said = b""
        if lost > 0:
            self._made += min(lost, round(_LONGEST_SKIP_S * self._output.rate_hz))
            said = self._core.run_until(self.time_us)
            self._core.take_samples()
            self._risen = 0
        said += self._core.receive(received, self.time_us)
        self._made += frames
        said += self._core.run_until(self.time_us)
        most = self._output.most
        samples = self._core.take_samples() * np.float32(most / SAMPLE_FULL_SCALE)
        if self._risen < self._rise:
            gain = np.minimum(1.0, (self._risen + np.arange(frames)) / self._rise)
            samples *= gain[:, None].astype(np.float32)
            self._risen += frames
        return np.clip(samples, -np.float32(most), np.float32(most)), said

    def hang_up(self) -> None:
        """The host is gone: ramp to zero and latch."""
        self._core.hang_up(self.time_us)

    def close(self) -> None:
        """Free the core; nothing else may be called afterwards."""
        self._core.close()


class CardPace:
    """How many samples a card has played by itself since it was last fed: silence, where a block came too late.

    A card asks for samples ahead of their time, by as much as its buffer holds. That lead is followed, since the clocks
    of card and host differ; where the card reports that it ran dry, what is missing of the lead was played as silence.
    """

    _FOLLOWED = 0.02

    def __init__(self, rate_hz: int) -> None:
        self._rate_hz = rate_hz
        self._start_ns: int | None = None
        self._asked = 0
        self._lead = 0.0

    def lost(self, now_ns: int, frames: int, *, ran_dry: bool) -> int:
        """Samples of silence before this block of `frames`; call it for every block."""
        if self._start_ns is None:
            self._start_ns = now_ns
        lead, lost = self._asked - (now_ns - self._start_ns) * self._rate_hz / 1e9, 0
        if ran_dry:
            lost = max(0, round(self._lead - lead))
            lead += lost
        self._lead += self._FOLLOWED * (lead - self._lead)
        self._asked += frames + lost
        return lost
