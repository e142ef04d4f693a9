"""When a steady drive is first felt: the plant simulated in time from rest, with the ramp of the firmware."""

import numpy as np

from engine.device import Device
from engine.render import clamp
from engine.table import Entry
from engine.touch import ZoneState
from firmware_link.emulator import Cause, ChannelTarget, DriveEvent, synthesise
from precompute.model.assembly import assemble
from precompute.model.modal import Basis, compute_basis
from precompute.model.threshold_filter import threshold_filter
from precompute.model.transient import TransientPlant

_LOOK_RATE_HZ = 16_000
_STEPS = 3  # of the plant, for each look: 48 kHz
_LONGEST_S = 0.3


class FeltStart:
    """Simulates the start of drives on one device."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._basis: Basis = compute_basis(assemble(device))
        self._filter = threshold_filter(_LOOK_RATE_HZ)

    def first_exceeds_s(self, entry: Entry) -> float | None:
        """Seconds until the last felt finger has passed the detection threshold; None if not within 0.3 s.

        A standard finger lies at the middle of each zone that is touched.
        """
        zones = self._device.zones
        touched = [i for i, zone in enumerate(entry.zones) if zone.state is not ZoneState.FREE]
        felt = [entry.zones[i].state is ZoneState.FELT for i in touched]
        places_m = np.array([(zones[i].start_m + zones[i].stop_m) / 2 for i in touched])
        drive = clamp(entry, self._device)
        targets = [ChannelTarget(each.frequency_hz, each.amplitude, each.phase_rad) for each in drive.channels]
        event = DriveEvent(0, Cause.SET, None, self._device.limits.slew_per_s, tuple(targets))
        rate_hz = _STEPS * _LOOK_RATE_HZ
        plant = TransientPlant(self._basis, places_m, rate_hz)
        plant.touch([(place_m, self._device.finger) for place_m in places_m.tolist()])
        acceleration = plant.accelerate(synthesise([event], 0.0, 1e6 * _LONGEST_S, rate_hz))
        courses = acceleration[::_STEPS, felt].T
        above = np.stack([abs(np.convolve(course, self._filter)[: len(course)]) > 1 for course in courses], axis=1)
        if not above.any(axis=0).all():
            return None
        return float(above.argmax(axis=0).max() / _LOOK_RATE_HZ)
