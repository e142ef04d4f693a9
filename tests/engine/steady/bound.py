"""Upper bound on the expected contrast of drives of one frequency, by Lagrangian duality.

A drive a (actuator,) has mean powers a^H N_i a under felt fingers and a^H D_j a under quiet ones. For any weights
n, d >= 0 that each sum to 1

    min_i a^H N_i a / max_j a^H D_j a  <=  a^H (sum n_i N_i) a / a^H (sum d_j D_j) a  <=  lambda_max,

the greatest eigenvalue of (sum n_i N_i) a = lambda (sum d_j D_j) a. So lambda_max bounds every drive whatever the
weights are; the best weights make it tight where the optimum is unique. No level is wanted here, which bounds drives
that reach one as well. With one felt and one quiet finger there are no weights, and the bound is the optimum.

Forms are computed apart from the solver: finite elements at the fingers' own positions, and dense low-rank updates.
"""

from functools import cache

import numpy as np
import scipy.linalg
import scipy.optimize

from base.arrays import Array, Complex, Mask
from engine.device import Device
from engine.steady.cases import FingerCases
from precompute.model.assembly import assemble
from precompute.model.response import solve_response
from precompute.predict.at_positions import SteadyDesigner
from tests.precompute.devices import shipped, three_actuators

DEVICES = {
    "reference-a": shipped("reference-a"),
    "reference-d": shipped("reference-d"),
    "reference-t": shipped("reference-t"),
    "three actuators": three_actuators(),
}


@cache
def designer_of(device: Device) -> SteadyDesigner:
    return SteadyDesigner(device)


def mean_forms(device: Device, cases: FingerCases, frequency_hz: Array) -> Complex:
    """Power over threshold of each finger as a form of the drive, averaged over cases: (finger, frequency, a, a)."""
    count, fingers = cases.position_m.shape
    at_m, actuators = cases.position_m.ravel(), len(device.actuators)
    plant = assemble(device)
    moved = plant.sampler(at_m).sample(solve_response(plant, frequency_hz, at_m).displacement_m)  # (hz, cause, place)
    omega = 2 * np.pi * frequency_hz
    stiffness, damping, mass = (cases.impedance[:, :, k] for k in range(3))
    per_m_per_s2 = omega**2 / device.threshold.peak_m_per_s2(frequency_hz)
    forms = np.zeros((fingers, len(frequency_hz), actuators, actuators), dtype=np.complex128)
    for case in range(count):
        own = slice(case * fingers, (case + 1) * fingers)
        drive = moved[:, :actuators, own].transpose(0, 2, 1)  # (hz, finger, actuator)
        point = moved[:, actuators:, own][:, own].transpose(0, 2, 1)
        pushed = stiffness[case] + 1j * omega[:, None] * damping[case] - omega[:, None] ** 2 * mass[case]
        loaded = np.linalg.solve(np.eye(fingers) + point * pushed[:, None, :], drive) * per_m_per_s2[:, None, None]
        forms += np.einsum("hfa,hfb->fhab", loaded.conj(), loaded) / count
    return forms


def bound_db(forms: Complex, felt: Mask, usable: Mask) -> float:
    """The bound in dB over all frequencies; `usable` (frequency, actuator): where each actuator may play."""
    N, D = forms[felt], forms[~felt]
    picks = [np.ix_(np.flatnonzero(row), np.flatnonzero(row)) for row in usable]

    def proved(weights: Array) -> float:
        """The greatest ratio over frequency that these logarithms of weights leave possible, in dB."""
        n, d = (np.exp(part - part.max()) for part in np.split(weights, [len(N)]))
        numerator, denominator = np.tensordot(n / n.sum(), N, 1), np.tensordot(d / d.sum(), D, 1)
        # Few cases may leave a form singular; a denominator that is greater by 1e-12 lowers the bound by nothing.
        denominator = denominator + 1e-12 * np.einsum("haa->h", denominator)[:, None, None] * np.eye(D.shape[-1])
        values = [
            scipy.linalg.eigh(a[pick], b[pick], eigvals_only=True)[-1]
            for a, b, pick in zip(numerator, denominator, picks, strict=True)
            if pick[0].size
        ]
        return float(10 * np.log10(max(values)))

    start = np.zeros(len(N) + len(D))
    if len(start) == 2:
        return proved(start)
    found = scipy.optimize.minimize(proved, start, method="Nelder-Mead", options={"maxiter": 60})
    return float(found.fun)


def ratio_db(forms: Complex, felt: Mask, amplitude: Complex) -> float:
    """The expected contrast of one drive, in dB; forms (finger, actuator, actuator) at its frequency."""
    power = np.einsum("a,fab,b->f", amplitude.conj(), forms, amplitude).real
    return float(10 * np.log10(power[felt].min() / power[~felt].max()))
