"""Responses under fingers at any positions, in NumPy: the receptances of the untouched bar, loaded with the fingers.

Receptances are interpolated between places by cubics, and all fingers of a case are attached at once, by one small
system of equations. `engine.steady.loading` does the same by compiled kernels.
"""

import numpy as np
from numpy.typing import NDArray

from engine.steady.cases import FingerCases
from engine.steady.receptances import Receptances

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Index = NDArray[np.int64]


class PlainLoading:
    """Loads the receptances of one device at all of its frequencies, or at those of `lines` (indices).

    drive (place, actuator, line): response over threshold of the untouched bar at full scale.
    """

    def __init__(self, receptances: Receptances, lines: slice = slice(None)) -> None:
        hz = receptances.frequency_hz[lines]
        self._place_m, self._pitch_m = receptances.place_m, receptances.pitch_m
        self._omega = 2 * np.pi * hz
        weight = self._omega**2 / receptances.threshold_m_per_s2[lines]
        self.drive: Complex = receptances.drive[..., lines].astype(np.complex128) * weight
        self._point = receptances.point[:, lines]

    def loaded(self, cases: FingerCases) -> Complex:
        """Response over threshold (case, line, finger, actuator) at full scale, all fingers on the bar."""
        cell, weight = self._cubics(cases.position_m)
        free = np.einsum("cfi,cfiak->ckfa", weight, self.drive[cell])
        between: Complex = np.array(
            [
                np.einsum("fi,gj,fgijk->kfg", w, w, self._point[self._pair(at[:, None, :, None], at[None, :, None, :])])
                for w, at in zip(weight, cell, strict=True)
            ]
        )
        coupled = np.eye(between.shape[2]) + between * self.impedance(cases)[:, :, None]
        return np.asarray(np.linalg.solve(coupled, free), dtype=np.complex128)

    def to_places(self, position_m: Array) -> Complex:
        """Receptance (line, place, finger), metres per newton, from positions (finger,) to every place."""
        cell, weight = self._cubics(position_m)
        every = np.arange(len(self._place_m))
        found: Complex = np.einsum("fi,pfik->kpf", weight, self._point[self._pair(every[:, None, None], cell)])
        return found

    def impedance(self, cases: FingerCases) -> Complex:
        """Force per displacement of each finger (case, line, finger)."""
        stiffness, damping, mass = np.moveaxis(cases.impedance[:, None], 3, 0)
        omega = self._omega[:, None]
        found: Complex = stiffness + 1j * omega * damping - omega**2 * mass
        return found

    def _pair(self, one: Index, other: Index) -> Index:
        """Indices of pairs of places in the upper triangle."""
        low, high = np.minimum(one, other), np.maximum(one, other)
        found: Index = low * len(self._place_m) - low * (low - 1) // 2 + high - low
        return found

    def _cubics(self, position_m: Array) -> tuple[Index, Array]:
        """The four places (..., 4) about positions (...), and the weights of the cubic through them."""
        at = position_m / self._pitch_m
        first = np.clip(at.astype(np.int64) - 1, 0, len(self._place_m) - 4)
        x = (at - first)[..., None] - np.arange(4)
        products = [np.delete(x, k, axis=-1).prod(axis=-1) for k in range(4)]
        weight = np.stack(products, axis=-1) / np.array([-6.0, 2.0, -2.0, 6.0])
        return first[..., None] + np.arange(4), weight
