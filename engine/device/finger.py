"""Fingers of device files: a mass, damper and spring to ground, stated or fitted to a measured impedance.

The impedance of such a finger, force over velocity at angular frequency w, is Z = c + j (w m - k / w). Everything that
is computed uses it: responses, steady drives, clicks, and the bar in time. A measured impedance could be put into
responses point by point, but not into time, where it must be a system with a state. Two fingers, one for drives and one
for clicks, would promise things that contradict each other. So a measured impedance is brought to a mass, damper and
spring when it is read: least squares of its relative error at the points within the sweep. That is also how it is
interpolated. Its misfit is kept and told. A finger that is farther off than `spread` allows is refused, and so is a
measurement that does not cover the sweep, outside of which drives are not searched.
"""

from dataclasses import dataclass

import numpy as np

from base.arrays import Array, Complex
from engine.device.description import DeviceTable
from engine.device.parts import Finger, Sweep

_LARGEST_SPREAD = 1000
_FEWEST_POINTS, _MOST_POINTS = 3, 10_000  # two points determine mass, damping and stiffness, a third one shows a misfit
_HIGHEST_HZ, _GREATEST_N_S_PER_M = 1e5, 1e9  # far above any finger, whose damping is about 1 N s/m: slips of units
_STATED = ("mass", "damping", "stiffness")


@dataclass(frozen=True)
class FingerOrigin:
    """Where the values of a finger come from, in words and numbers.

    impedance: (frequency in Hz, real and imaginary part in N s/m) of each measured point; empty: the values are stated.
    misfit: greatest distance of the fitted impedance from a measured one within the sweep, as a fraction of the
    measured one; None where nothing was fitted.
    """

    name: str
    source: str
    impedance: tuple[tuple[float, float, float], ...] = ()
    misfit: float | None = None


def read_finger(part: DeviceTable, sweep: Sweep) -> tuple[Finger, FingerOrigin]:
    """The table [finger], and where its values come from. A value that stands beside an impedance replaces its own."""
    spread = part.take_value("spread", 1.0)
    part.assume("spread")
    if isinstance(spread, bool) or not isinstance(spread, int | float) or not 1 <= spread <= _LARGEST_SPREAD:
        raise part.error("spread", spread, "expected a factor of at least 1, such as 3.0")
    name = part.name("name") if part.has("name") else ""
    source, points = part.sentence("source"), _read_impedance(part, sweep)
    is_replaced = any(key in part.left for key in _STATED)
    fitted = _fit(*_within(points, sweep)) if points else None
    mass_kg, damping_n_s_per_m, stiffness_n_per_m = (
        part.quantity(key, unit, default=None if fitted is None else f"{fitted[number]!r} {unit}")
        for number, (key, unit) in enumerate(zip(_STATED, ("kg", "N*s/m", "N/m"), strict=True))
    )
    finger = Finger(mass_kg, damping_n_s_per_m, stiffness_n_per_m, float(spread))
    misfit = None
    if points:
        hz, measured = _within(points, sweep)
        ratio = impedance_of(finger, hz) / measured
        misfit = float(abs(ratio - 1).max())
        worst = max(float(abs(ratio).max()), 1 / max(float(abs(ratio).min()), 1e-300))
        if worst > spread and not is_replaced:
            raise part.error(
                "impedance",
                f"{len(points)} points",
                f"no mass, damper and spring comes nearer than a factor of {worst:.2f}, more than spread, {spread:g}; "
                f"raise spread, or state mass, damping and stiffness in place of the impedance",
            )
    return finger, FingerOrigin(name, source, points, misfit)


def impedance_of(finger: Finger, frequency_hz: Array) -> Complex:
    """Impedance (frequency,) in N s/m, force over velocity."""
    omega = 2 * np.pi * frequency_hz
    reactance = omega * finger.mass_kg - finger.stiffness_n_per_m / omega
    return np.asarray(finger.damping_n_s_per_m + 1j * reactance, dtype=np.complex128)


def _read_impedance(part: DeviceTable, sweep: Sweep) -> tuple[tuple[float, float, float], ...]:
    """The measured points by rising frequency; none where the key is absent."""
    if not part.has("impedance"):
        return ()
    rows = part.left.pop("impedance")
    expected = (
        f"expected {_FEWEST_POINTS} to {_MOST_POINTS} points [frequency in Hz, real, imaginary part in N s/m], by "
        f"rising frequency, real parts of 0 or more; or the path of a CSV file of them"
    )
    if not isinstance(rows, list) or not _FEWEST_POINTS <= len(rows) <= _MOST_POINTS:
        raise part.error("impedance", rows, expected)
    if not all(isinstance(row, list) and len(row) == 3 and all(map(_is_number, row)) for row in rows):
        raise part.error("impedance", rows, expected)
    for k, (hz, real, imaginary) in enumerate(rows):
        if not (rows[k - 1][0] if k else 0) < hz <= _HIGHEST_HZ or real < 0 or not 0 < abs(real + 1j * imaginary) < 1e9:
            raise part.error("impedance", rows[k], f"point {k + 1}: {expected}")
    if rows[0][0] > sweep.start_hz or rows[-1][0] < sweep.stop_hz:
        measured = f"measured from {rows[0][0]:g} to {rows[-1][0]:g} Hz"
        raise part.error("impedance", measured, f"does not cover the sweep, {sweep.start_hz:g}-{sweep.stop_hz:g} Hz")
    return tuple((float(hz), float(real), float(imaginary)) for hz, real, imaginary in rows)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= _GREATEST_N_S_PER_M


def _within(points: tuple[tuple[float, float, float], ...], sweep: Sweep) -> tuple[Array, Complex]:
    """Frequencies (point,) and impedances (point,) within the sweep, with the nearest points beyond its ends."""
    hz, real, imaginary = np.array(points).T
    first = int(np.searchsorted(hz, sweep.start_hz, side="right")) - 1
    last = int(np.searchsorted(hz, sweep.stop_hz, side="left"))
    return hz[first : last + 1], (real + 1j * imaginary)[first : last + 1]


def _fit(frequency_hz: Array, impedance: Complex) -> tuple[float, float, float]:
    """Mass, damping and stiffness of 0 or more with the least squares of the relative error.

    The real part has the damping alone. The imaginary part has mass and stiffness; where one of them comes out
    negative, the optimum has it at 0, since the problem is convex.
    """
    omega, weight = 2 * np.pi * frequency_hz, 1 / abs(impedance)
    damping = float(np.average(impedance.real, weights=weight**2))
    columns, wanted = np.stack([omega, -1 / omega], axis=1) * weight[:, None], impedance.imag * weight
    size = np.sqrt((columns**2).sum(axis=0))  # kg and N/m differ by orders of magnitude
    mass, stiffness = np.linalg.lstsq(columns / size, wanted, rcond=None)[0]
    if min(mass, stiffness) < 0:
        alone = np.maximum(wanted @ columns / size, 0.0)
        mass, stiffness = (alone[0], 0.0) if stiffness < 0 else (0.0, alone[1])
    return float(mass / size[0]), damping, float(stiffness / size[1])
