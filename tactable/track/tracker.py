"""Samples and touches to the drift so far, the load of each finger, and the device that a table is due for.

A window is a stretch that is driven, with the same fingers all the time; it begins where they change, or where the one
before ends. A sample's time is when its block arrived, some milliseconds late, and a touch's when its report was read,
so a finger is known before the drive that answers it. Only which fingers lie there is taken from these times.
"""

import math
from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np

from base.arrays import Array
from engine.device import Device
from engine.steady.cases import MeasuredFinger
from tactable.measure.sensor import Block, Sensor, SensorError
from tactable.track.estimator import Contacts, Estimate, LoadEstimator

STEP = 0.005
"""Change of the drift after which a table is made again (docs/tracking.md)."""
_FEWEST_TOUCHES = 3
_SURE = 2.0  # standard errors
_PATIENCE = 8  # refused windows in a row after which the table is said to be left
_LENGTH_S = 0.1  # 30 ms of a click and its ringing; of a steady drive 6 periods of 60 Hz and more
_DRIVEN = 1e-3  # of full scale: 60 dB below it
_SAME_M = 1.5e-3  # a finger that moves farther within a window is another placement
_KNOWN = 4.0  # a finger is known whose standard error is a quarter of its spread's logarithm: half of what it was
_LOAD_STEP, _NEAR_M = 0.2, 3e-3  # changes of a measured finger after which the loop gets it again (ESTIMATES)
_NS_PER_S = 1_000_000_000


class Tracker:
    """Tracks one device by one sensor at a point.

    Raises SensorError for a sensor without the drive of every actuator beside it, and DeviceError as `LoadEstimator`.
    """

    def __init__(self, device: Device, sensor: Sensor, at_m: complex, mass_kg: float) -> None:
        form, loopbacks = sensor.form, [sensor.form.loopback(actuator.name) for actuator in device.actuators]
        if None in loopbacks:
            missing = device.actuators[loopbacks.index(None)].name
            raise SensorError(f"--track: the sensor has no loopback of actuator {missing}: record the drive of each")
        self.estimate: Estimate | None = None
        self.made_for = 0.0  # the drift that the table is made for
        self._rescaled = list[dict[str, float]]()
        self._estimator = LoadEstimator(device, at_m, mass_kg, form.sample_rate_hz)
        self._sensor, self._rate_hz = sensor, form.sample_rate_hz
        self._columns = [form.acceleration, *(index for index in loopbacks if index is not None)]
        self._rows = np.empty((0, len(self._columns)))
        self._began_ns = self._last_ns = self._used = self._refused = self._in_a_row = 0
        self._agreeing, self._last_touch = 0, frozenset[int]()  # touches with a window since the last table
        self._known = math.log(device.finger.spread) / _KNOWN
        self._told = dict[int, MeasuredFinger]()
        self._touches = deque[tuple[int, Contacts]]([(0, {})])

    def take_touches(self, time_ns: int, contacts: Contacts) -> None:
        """The fingers from `time_ns` on."""
        before = self._touches[-1][1]
        if contacts.keys() != before.keys() or any(abs(contacts[each] - before[each]) > _SAME_M for each in contacts):
            self._touches.append((time_ns, contacts))

    def take_block(self, block: Block) -> bool:
        """Samples that follow those before; whether a window came of them."""
        self._rows = np.concatenate([self._rows, block.values[:, self._columns]])
        self._began_ns = self._began_ns or block.arrived_ns
        margin, length, is_new = self._estimator.margin, round(_LENGTH_S * self._rate_hz), False
        while len(self._rows) >= margin + length:
            start_ns, stop_ns = (
                block.arrived_ns - self._lasts_ns(len(self._rows) - row) for row in (margin, margin + length)
            )
            while len(self._touches) > 1 and self._touches[1][0] <= start_ns:
                self._touches.popleft()
            if len(self._touches) > 1 and self._touches[1][0] < stop_ns:  # a window begins with the new fingers
                self._rows = self._rows[max(1, math.ceil((self._touches[1][0] - start_ns) / self._lasts_ns(1))) :]
                continue
            samples, self._rows = self._rows[: margin + length], self._rows[length:]
            if np.isfinite(samples).all() and abs(samples[:, 1:]).max() > _DRIVEN:
                self._take_window(samples, self._touches[0][1], stop_ns)
                is_new = True
        return is_new

    def _lasts_ns(self, samples: int) -> int:
        return round(samples / self._rate_hz * _NS_PER_S)

    def _take_window(self, samples: Array, contacts: Contacts, stop_ns: int) -> None:
        self._estimator.rate_hz = self._rate_hz * (1 + self._sensor.pace())
        elapsed_s = (stop_ns - (self._last_ns or stop_ns)) / _NS_PER_S
        self.estimate = self._estimator.take_window(samples, contacts, elapsed_s)
        self._last_ns, is_refused = stop_ns, bool(self.estimate.refusal)
        self._used, self._refused = self._used + (not is_refused), self._refused + is_refused
        self._in_a_row = self._in_a_row + 1 if is_refused else 0
        if not is_refused and contacts.keys() != self._last_touch:
            self._last_touch, self._agreeing = frozenset(contacts), self._agreeing + 1

    def due_device(self) -> Device | None:
        """The device that a new table is due for: the drift has left that of the table by more than a step.

        Several touches must have told of it since the last table: under one the model errs the same way all the time.
        """
        found = self.estimate
        if (
            found is None
            or self._agreeing < _FEWEST_TOUCHES
            or abs(found.drift - self.made_for) < max(STEP, _SURE * found.drift_error)
        ):
            return None
        return found.device

    def due_fingers(self) -> list[MeasuredFinger] | None:
        """All measured fingers on the surface, where one of them differs from what this last returned; else None."""
        loads, found = {} if self.estimate is None else self.estimate.loads, dict[int, MeasuredFinger]()
        for contact, at_m in self._touches[-1][1].items():
            load, error = loads.get(contact, (0.0, math.inf))
            if error < self._known:
                found[contact] = MeasuredFinger(at_m, load, error)
        was = self._told
        if found.keys() == was.keys() and all(
            abs(each.load - was[contact].load) < _LOAD_STEP and abs(each.position_m - was[contact].position_m) < _NEAR_M
            for contact, each in found.items()
        ):
            return None
        self._told = found
        return list(found.values())

    def note_rescaled(self, drift: float, now_ns: int) -> None:
        """The table is built for this drift from now on."""
        self.made_for, self._agreeing = drift, 0
        self._rescaled.append({"after_s": (now_ns - self._began_ns) / _NS_PER_S, "drift": drift})

    def status(self) -> Mapping[str, Any]:
        """What is known, as JSON values (tactable.run.track_status)."""
        found = self.estimate
        return {
            "simulated": self._sensor.form.is_simulated,
            "windows": self._used,
            "refused": self._refused,
            "drift": None if found is None else found.drift,
            "drift_error": None if found is None else found.drift_error,
            "loads": {} if found is None else found.loads,
            "trouble": found.refusal if found is not None and self._in_a_row >= _PATIENCE else "",
            "rescaled": self._rescaled,
        }
