"""The delays and gains between the channels of a board, by the loopback channels that record its outputs.

Theory of operation. All actuators play one tone in phase, whose SET starts them on one sample; each loopback shows when
and how strongly its own output plays. Loopbacks pass through one converter, so their ratio has neither clock nor
latency in it. Two tones tell a delay from a plug that is turned. The responses of each actuator are relative to its own
loopback, which is late by as much and hides what these ratios say: times the ratio they are relative to the command,
and `calibrate` fits full scale and delay of each channel to them. Where records are equal to the last bit, they are of
one channel, or of what was asked for: nothing is known then.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from base.arrays import Complex
from tactable.measure.asked_drive import AskedDrive
from tactable.measure.faults import Fault
from tactable.measure.stepped_sine import SteppedSine

_WITHIN = (0.1, 0.9)  # of the band that all actuators have: the two tones, 84 and 276 Hz of 60 to 300 Hz


@dataclass(frozen=True)
class Channel:
    """An output beside that of the first actuator: gain, negative for a turned plug, and how much later it plays."""

    gain: float
    delay_s: float

    def factor(self, frequency_hz: float) -> complex:
        """What its tone is to that of the first actuator."""
        return complex(self.gain * np.exp(-2j * np.pi * frequency_hz * self.delay_s))


def compare_channels(stepped: SteppedSine) -> tuple[Channel, ...]:
    """The channels of all actuators, the first 1 and 0 s; none where they have no loopbacks of their own or no signal.

    Delays of up to half a period of the tones' difference are told, 2.6 ms of a band of 60 to 300 Hz. Raises as
    `SteppedSine.read`.
    """
    device, count = stepped.device, len(stepped.device.actuators)
    references = [index for i in range(count) if (index := stepped.reference(i)) is not None]
    low_hz = max(actuator.band_hz[0] for actuator in device.actuators)
    high_hz = min(actuator.band_hz[1] for actuator in device.actuators)
    if len(references) < max(count, 2) or low_hz >= high_hz:
        return ()
    tones_hz, ratios = list[float](), list[Complex]()
    for part in _WITHIN:
        hz = stepped.played_hz(low_hz + part * (high_hz - low_hz))
        asked = AskedDrive((hz,) * count, (stepped.options.least,) * count, (0.0,) * count)
        fit, values, faults = stepped.hold(asked)
        drives = values[:, references]
        if Fault.NO_SIGNAL in faults or Fault.LOST_SAMPLES in faults or (drives == drives[:, :1]).all():
            return ()
        tones_hz.append(hz)
        ratios.append(fit.phasor[references] / fit.phasor[references[0]])
    return channels_of(tones_hz, ratios)


def channels_of(tones_hz: Sequence[float], ratios: Sequence[Complex]) -> tuple[Channel, ...]:
    """Channels from their ratios (actuator,) to the first one at two rising frequencies."""
    omega, (low, high) = 2 * np.pi * np.array(tones_hz), ratios
    delay_s = -np.angle(high / low) / (omega[1] - omega[0])
    sign = np.where((low * np.exp(1j * omega[0] * delay_s)).real < 0, -1.0, 1.0)
    # The slope is known roughly; the phases themselves tell it to a fraction of that.
    off = np.angle(np.array(ratios) * sign * np.exp(1j * omega[:, None] * delay_s))
    delay_s = delay_s - (omega @ off) / (omega @ omega)
    gain = sign * np.abs(ratios).mean(axis=0)
    return tuple(Channel(*each) for each in zip(gain.tolist(), delay_s.tolist(), strict=True))
