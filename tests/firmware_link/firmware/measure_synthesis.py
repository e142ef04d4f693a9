"""How pure the tones of the C core are: `python -m tests.firmware_link.firmware.measure_synthesis` prints a table.

A drive is armed and held over the wire for seconds of device time; the samples that the actuators got are looked at by
FFT, and the line itself by a least-squares fit.
"""

import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from base.arrays import Array
from firmware_link.protocol.drive_words import ChannelDrive, decode_drive, encode_drive
from firmware_link.protocol.messages import KeepAlive, Set, SetFlag
from tests.firmware_link.firmware.compiled_core import FULL_OUTPUT, US_PER_S, Played
from tests.firmware_link.strategies import RESOLUTION_HZ
from tests.firmware_link.virtual_rig import reference

LEASE_MS = 100
KEEP_ALIVE_US = 50_000
SETTLED_US = 100_000
DURATION_US = 8 * US_PER_S
# A window whose side lobes end 160 dB down: what is left of the line is the synthesis.
KAISER_BETA = 24.0
LINE_WIDTH_BINS = 32


@dataclass(frozen=True)
class Quality:
    """Of one tone on two channels a known angle apart; spurious is the greatest other line below it."""

    frequency_hz: float
    frequency_error_uhz: float
    spurious_db: float
    phase_error_rad: float
    amplitude_error: float


def measure(rate_hz: int, frequency_hz: float, amplitude: float, phase_rad: float) -> Quality:
    """Quality of one tone; the second channel leads by the word next to `phase_rad`."""
    wanted = [ChannelDrive(frequency_hz, amplitude), ChannelDrive(frequency_hz, amplitude, phase_rad)]
    channels = decode_drive(encode_drive(wanted, RESOLUTION_HZ), RESOLUTION_HZ)
    samples = play(rate_hz, channels)
    (error_hz, first), (_, second) = (fit(column, rate_hz, frequency_hz) for column in samples.T)
    return Quality(
        frequency_hz=frequency_hz,
        frequency_error_uhz=1e6 * error_hz,
        spurious_db=max(spurious_db(column, rate_hz, frequency_hz) for column in samples.T),
        phase_error_rad=abs(math.remainder(float(np.angle(second / first)) - channels[1].phase_rad, math.tau)),
        amplitude_error=abs(abs(first) - amplitude),
    )


def play(rate_hz: int, channels: Sequence[ChannelDrive]) -> Array:
    """Displacements (time, actuator) of a drive that is held, once its ramp is over, in fractions of full scale."""
    device = Played(rate_hz, (65_535, 65_535), 200, lease_ms=LEASE_MS)
    device.send(Set(reference(device.now_us), SetFlag.WRITE_PHASE, LEASE_MS, encode_drive(channels, RESOLUTION_HZ)))
    applied = device.encoder.sequence
    while device.now_us < SETTLED_US + DURATION_US:
        device.wait(KEEP_ALIVE_US)
        device.send(KeepAlive(reference(device.now_us), applied))
    samples = device.take()[SETTLED_US * rate_hz // US_PER_S :]
    return samples[: DURATION_US * rate_hz // US_PER_S] / FULL_OUTPUT


def fit(samples: Array, rate_hz: int, frequency_hz: float) -> tuple[float, complex]:
    """Frequency error in Hz, and complex amplitude at the wanted frequency: how the phase moves from half to half."""
    time_s = np.arange(len(samples)) / rate_hz
    turned = samples * np.exp(-1j * math.tau * frequency_hz * time_s)
    window = np.kaiser(len(samples) // 2, KAISER_BETA)
    first, second = (2j * (half * window).sum() / window.sum() for half in np.split(turned, 2))
    apart_s = len(window) / rate_hz
    return float(np.angle(second / first)) / math.tau / apart_s, complex(first + second) / 2


def spurious_db(samples: Array, rate_hz: int, frequency_hz: float) -> float:
    """Greatest line outside the tone's own, relative to it."""
    spectrum = np.abs(np.fft.rfft(samples * np.kaiser(len(samples), KAISER_BETA)))
    at = round(frequency_hz * len(samples) / rate_hz)
    line = spectrum[max(0, at - LINE_WIDTH_BINS) : at + LINE_WIDTH_BINS].max()
    spectrum[max(0, at - LINE_WIDTH_BINS) : at + LINE_WIDTH_BINS] = 0.0
    return float(20 * math.log10(spectrum.max() / line))


def table() -> Iterator[str]:
    """Rows of Markdown."""
    yield "| rate | tone | amplitude | frequency error | greatest spurious line | phase error between channels |"
    yield "|---|---|---|---|---|---|"
    for rate_hz in (8_000, 48_000):
        for frequency_hz, amplitude in ((60.0, 1.0), (187.53, 1.0), (655.35, 1.0), (187.53, 0.1)):
            quality = measure(rate_hz, frequency_hz, amplitude, 1.0)
            yield (
                f"| {rate_hz / 1000:g} kHz | {frequency_hz:g} Hz | {amplitude:g} "
                f"| {quality.frequency_error_uhz:+.2f} µHz | {quality.spurious_db:.0f} dB "
                f"| {1e6 * quality.phase_error_rad:.2f} µrad |"
            )


if __name__ == "__main__":
    sys.stdout.write("\n".join(table()) + "\n")
