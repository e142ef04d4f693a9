"""The steady motion of a bar with fingers as a sum of modes, which takes no compiled kernel."""

import numpy as np
from numpy.typing import NDArray

from engine.device import Device
from precompute.model.assembly import assemble
from precompute.model.modal import compute_basis, compute_modal_model
from precompute.model.transfers import transfers_at
from tactable.rig.first_table import MODES

Complex = NDArray[np.complex128]


class ModalBar:
    """A bar of MODES modes, on which standard fingers lie."""

    def __init__(self, device: Device) -> None:
        self._device, self.basis = device, compute_basis(assemble(device), MODES)
        self._force = compute_modal_model(self.basis).push

    def acceleration(self, frequency_hz: float, position_m: tuple[float, ...]) -> Complex:
        """Acceleration (finger, actuator) in m/s^2 under fingers at these positions, at full scale of each actuator."""
        s, basis, finger = 2j * np.pi * frequency_hz, self.basis, self._device.finger
        rows = basis.at(np.array(position_m))
        touch = finger.stiffness_n_per_m + s * finger.damping_n_s_per_m + s**2 * finger.mass_kg
        dynamic = np.diag(basis.square_omega + s**2) + s * basis.damping + touch * (rows.T @ rows)
        force = self._force[:, 0] + s * self._force[:, 1]
        transfers = transfers_at(self._device.actuators, np.array(s))
        per_base = s**2 * rows @ np.linalg.solve(dynamic, force)
        return np.asarray(per_base if transfers is None else per_base * transfers, dtype=np.complex128)
