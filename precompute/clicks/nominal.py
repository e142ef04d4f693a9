"""What standard fingers of any placement get of a waveform, in the nominal plant; no kernel needs to be compiled."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from engine.device import Device
from engine.table import ClickEntry
from engine.table.click import ClickFinger
from firmware_link.protocol.basis import SAMPLE_FULL_SCALE
from precompute.clicks.basis import lines_for
from precompute.clicks.evaluation import fingers_of, nominal_courses
from precompute.clicks.options import ClickOptions
from precompute.clicks.plants import output_factor, weighting
from precompute.clicks.responses import Responses
from precompute.model.assembly import assemble
from precompute.model.modal import compute_basis
from precompute.model.transfers import transfers_at

Complex32 = NDArray[np.complex64]

MODES = 32


class NominalFingers:
    """The nominal plant of a device as clicks of these options are evaluated; modes: how many move."""

    def __init__(self, device: Device, options: ClickOptions, modes: int = MODES) -> None:
        self._device, self._basis = device, compute_basis(assemble(device), modes)
        self._lines = lines_for(device, options.length_s)
        self._weighting = weighting(self._lines, device.threshold)
        self.transfer_of = lru_cache(maxsize=4)(self._solve)
        """Transfer functions (1, finger, actuator, line) with standard fingers at a tuple of positions."""

    def under(self, click: ClickEntry, position_m: tuple[float, ...]) -> tuple[ClickFinger, ...]:
        """What a click gives to standard fingers at these positions, as it is played."""
        played = click.amplitude / SAMPLE_FULL_SCALE * click.samples.astype(np.float64)
        responses = Responses(self.transfer_of(position_m), self._lines)
        return fingers_of(*nominal_courses(responses, played.T, self._weighting))

    def _solve(self, position_m: tuple[float, ...]) -> Complex32:
        """(s^2 + s C + Omega^2 + sum of the fingers' z phi phi^T) q = phi of the actuators, solved line by line."""
        device, basis, s = self._device, self._basis, self._lines.s_per_s
        finger, actuators = device.finger, device.actuators
        under = basis.at(np.array(position_m))
        impedance = finger.stiffness_n_per_m + finger.damping_n_s_per_m * s + finger.mass_kg * s**2
        dynamic = s[:, None, None] * basis.damping + impedance[:, None, None] * (under.T @ under)
        mode = np.arange(len(basis.square_omega))
        dynamic[:, mode, mode] += s[:, None] ** 2 + basis.square_omega
        force = np.array([(a.stiffness_n_per_m + a.damping_n_s_per_m * s) * a.full_scale_m for a in actuators])
        driven = basis.at(np.array([actuator.position_m for actuator in actuators]))
        moved = under @ np.linalg.solve(dynamic, np.broadcast_to(driven.T, (len(s), *driven.T.shape)))
        transfer = moved.transpose(1, 2, 0) * force * output_factor(self._lines, device.threshold)
        own = transfers_at(actuators, s)
        single: Complex32 = (transfer if own is None else transfer * own.T)[None].astype(np.complex64)
        return single
