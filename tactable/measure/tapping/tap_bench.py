"""A surface that is tapped with a hammer, and its converter. SIMULATED.

A tap is a half-sine of force: an actuator that is nothing but a force stands at its place in the model.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from base.arrays import Array
from engine.device import Actuator, Device, Finger
from precompute.model.assembly import assemble
from precompute.model.modal import compute_basis
from precompute.model.transient import TransientPlant
from tactable.measure.sensor import ACCELERATION, FORCE, SensorForm
from tactable.measure.simulated_bench import Converter, ConverterFlaws

RATE_HZ, _PLANT_SAMPLES = 24_000.0, 2
_SOFTEST_N_PER_M = 1e-3  # spring of the stand-in: a millionth of an actuator's
_CONTACT_S, _WEAKEST_N, _STRONGEST_N = 1.5e-3, 0.4, 1.0  # of a small hammer on a bar of some grams


class TapBench:
    """A surface with a sensor that stays at `sensor_m`, and the load cell of the hammer."""

    def __init__(
        self, device: Device, flaws: ConverterFlaws, seed: int, sensor_m: complex, sensor_mass_kg: float
    ) -> None:
        self._device, self._sensor_m, self._random = device, sensor_m, np.random.default_rng(seed)
        self._sensor = Finger(sensor_mass_kg, 0.0, 0.0, 1.0)
        clips_at = (flaws.clips_at_m_per_s2, np.inf)
        self.form = SensorForm(RATE_HZ, (ACCELERATION, FORCE), clips_at, is_simulated=True)
        self._converter = Converter(flaws, self.form, False, self._random)

    def record(self, position_m: complex, times_s: Sequence[float], seconds: float) -> Array:
        """Samples (sample, channel) of contacts at these times, at one place, each with a force of its own."""
        plant_hz = RATE_HZ * _PLANT_SAMPLES
        time_s = np.arange(round(seconds * plant_hz)) / plant_hz
        force_n = np.zeros(len(time_s))
        for start_s in times_s:
            within = (time_s >= start_s) & (time_s < start_s + _CONTACT_S)
            strength_n = self._random.uniform(_WEAKEST_N, _STRONGEST_N)
            force_n[within] += strength_n * np.sin(np.pi * (time_s[within] - start_s) / _CONTACT_S)
        spring = _SOFTEST_N_PER_M
        hammer = Actuator("hammer", position_m, spring, 0.0, 0.0, 1 / spring, (1.0, RATE_HZ), is_force=True)
        tapped = replace(self._device, actuators=(*self._device.actuators, hammer))
        plant = TransientPlant(compute_basis(assemble(tapped)), np.array([self._sensor_m]), plant_hz)
        plant.touch([(self._sensor_m, self._sensor)])
        drive = np.zeros((len(time_s), len(tapped.actuators)))
        drive[:, -1] = force_n
        kept = slice(None, None, _PLANT_SAMPLES)
        return self._converter.convert(plant.accelerate(drive)[kept, 0], force_n[kept, None], time_s[kept])
