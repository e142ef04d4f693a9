"""Responses under fingers at any positions, in NumPy: sums over the modes of the untouched surface, with fingers.

All fingers of a case are attached at once, by one small system of equations. `engine.steady.loading` does the same by
compiled kernels.
"""

from dataclasses import replace

import numpy as np

from base.arrays import Complex, Points
from engine.steady.cases import FingerCases
from engine.steady.modes import Modes


class PlainLoading:
    """Loads the surface of one device at all frequencies of its modes, or at those of `lines` (indices)."""

    def __init__(self, modes: Modes, lines: slice = slice(None)) -> None:
        self._modes = modes = replace(
            modes,
            frequency_hz=modes.frequency_hz[lines],
            threshold_m_per_s2=modes.threshold_m_per_s2[lines],
            drive=modes.drive[..., lines],
        )
        self._omega = 2 * np.pi * modes.frequency_hz
        self._own = len(modes.natural_frequency_hz)

    def untouched(self, points_m: Points) -> Complex:
        """Response over threshold (..., line, actuator) at full scale at points (...,), no finger on the surface."""
        response = np.einsum("...m,mak->...ka", self._modes.at(points_m), self._modes.drive, optimize=True)
        return response * self._modes.per_threshold[:, None]

    def loaded(self, cases: FingerCases) -> Complex:
        """Response over threshold (case, line, finger, actuator) at full scale, all fingers on the surface."""
        free = self.untouched(cases.position_m).swapaxes(1, 2)
        coupled = np.array([self.receptances(each, each) for each in cases.position_m])
        coupled = np.eye(coupled.shape[2]) + coupled * self.impedance(cases)[:, :, None]
        return np.asarray(np.linalg.solve(coupled, free), dtype=np.complex128)

    def receptances(self, points_m: Points, others_m: Points) -> Complex:
        """Receptance (line, point, other), metres per newton, of the untouched surface."""
        modes = self._modes
        one, other = (modes.at(each)[..., : self._own] for each in (points_m, others_m))
        taken, also = (np.einsum("pm,mdk->kpd", shape, modes.damped, optimize=True) for shape in (one, other))
        return (one * modes.modal.T[:, None]) @ other.T - taken @ also.swapaxes(1, 2)

    def impedance(self, cases: FingerCases) -> Complex:
        """Force per displacement of each finger (case, line, finger)."""
        stiffness, damping, mass = np.moveaxis(cases.impedance[:, None], 3, 0)
        omega = self._omega[:, None]
        return stiffness + 1j * omega * damping - omega**2 * mass
