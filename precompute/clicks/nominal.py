"""What standard fingers anywhere get of a click: the nominal plant in time, which needs no compiled kernel."""

from functools import lru_cache

import numpy as np

from base.arrays import Array
from engine.device import Device
from engine.table import ClickEntry
from engine.table.clicks import ClickFinger
from firmware_link.protocol.basis import SAMPLE_FULL_SCALE
from precompute.clicks.click_basis import EVALUATION_RATE_HZ, EVALUATIONS_PER_SAMPLE, RINGDOWN_S, SAMPLE_RATE_HZ
from precompute.clicks.evaluation import fingers_of
from precompute.model.assembly import assemble
from precompute.model.modal import compute_basis
from precompute.model.threshold_filter import threshold_filter
from precompute.model.transient import TransientPlant

_STEPS = 12  # steps for each sample; acceleration changes sharply at the corners of the waveform
_RINGING_STEPS = 4  # steps from _SHARP_S after the waveform on: a peak at 300 Hz is missed by less than 0.02 dB
_SHARP_S = 5e-3  # time after which what the last corner of the waveform excites above 1 kHz is damped


class NominalFingers:
    """The nominal plant of a device; modes: how many move. None: as many as the band needs, which takes kernels."""

    def __init__(self, device: Device, modes: int | None = None) -> None:
        self._device = device
        self._modes = compute_basis(assemble(device), modes)
        self._filter = threshold_filter(device.threshold, EVALUATION_RATE_HZ)
        self._plant_of = lru_cache(maxsize=4)(self._make_plant)
        """The plant with fingers at a tuple of positions; clicks with the same fingers come together."""

    def under(self, click: ClickEntry, position_m: tuple[complex, ...]) -> tuple[ClickFinger, ...]:
        """What a click gives to standard fingers at these positions, as it is played."""
        played = click.amplitude / SAMPLE_FULL_SCALE * click.samples.astype(np.float64)
        plant = self._plant_of(position_m)
        plant.rest()
        at = np.arange((len(played) - 1) * _STEPS + 1) / _STEPS
        moved = np.column_stack([np.interp(at, np.arange(len(played)), column) for column in played.T])
        moved = np.pad(moved, ((0, round(_SHARP_S * SAMPLE_RATE_HZ) * _STEPS), (0, 0)))
        plant.sample_rate_hz = _STEPS * SAMPLE_RATE_HZ
        driven = plant.accelerate(moved)
        plant.sample_rate_hz = _RINGING_STEPS * SAMPLE_RATE_HZ
        steps = round((RINGDOWN_S - _SHARP_S) * plant.sample_rate_hz)
        ringing = plant.accelerate(np.zeros((steps, moved.shape[1])))
        # The first instant of the ringing is one step after the last that was driven.
        evaluated = [
            driven[:: _STEPS // EVALUATIONS_PER_SAMPLE],
            ringing[_RINGING_STEPS // EVALUATIONS_PER_SAMPLE - 1 :: _RINGING_STEPS // EVALUATIONS_PER_SAMPLE],
        ]
        course = np.concatenate(evaluated)
        weighted: Array = np.stack([np.convolve(column, self._filter)[: len(course)] for column in course.T])
        acceleration: Array = abs(np.concatenate([driven, ringing]))
        return fingers_of(acceleration.T, abs(weighted))

    def _make_plant(self, position_m: tuple[complex, ...]) -> TransientPlant:
        plant = TransientPlant(self._modes, np.array(position_m), _STEPS * SAMPLE_RATE_HZ)
        plant.touch([(at_m, self._device.finger) for at_m in position_m])
        return plant
