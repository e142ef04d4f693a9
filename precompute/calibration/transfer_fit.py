"""Transfer functions of the actuators from measured responses: what the model of the bar does not explain.

Theory of operation
-------------------
A reading of one actuator alone is H(f) g(f, place): g is the response of the model with the base moving as commanded, H
belongs to driver and actuator and is the same at all places. So at each frequency H is fitted to the readings of all
places, by least squares, and the distance of the places from the fit is one part of its error.

The other part no number of places shows: a model whose resonance lies 0.2 % off has the right shape along the bar and
the wrong size, and its error would pass for an H. So the fit is repeated with bars sampled within what is known of the
device (its spread, or what a calibration has left), and their standard deviation is added. Frequencies at which the
error is more than GREATEST_ERROR are left out: near a resonance of a bar that was not calibrated nothing is found.

What accelerometers cannot tell: an H of one size at all frequencies is a full scale, or a stiffness. H is therefore
relative to the full scale that the device file states, and it is found only where the bar is known better than H.
"""

from dataclasses import dataclass, replace

import numpy as np

from base.arrays import Array, Complex
from engine.device import Device, Transfer
from engine.device.actuator_transfer import FEWEST_POINTS
from engine.steady.cases import SEED
from precompute.measurements.model import MeasurementModel
from precompute.measurements.types import CalibrationError, Kind, Measurements
from precompute.sampling.plants import sample_scenarios

GREATEST_ERROR = 0.1
"""Standard error of a point, relative to it, that is still taken: 0.8 dB or 6 degrees."""
FEWEST_PLACES = 3  # two fit one H at any model; the third one shows whether the model holds
_BARS = 32  # a standard deviation of 32 is 13 % uncertain, of 8 27 %; each is a model of all readings


class TransferError(CalibrationError):
    """Responses give no transfer function; the message says what is missing and what to measure."""


@dataclass(frozen=True)
class FoundTransfer:
    """The transfer function of one actuator: points (point,), and their standard errors relative to them.

    left_out_hz: frequencies at which the error was too large, or the places too few.
    """

    frequency_hz: Array
    value: Complex
    error: Array
    left_out_hz: Array

    @property
    def transfer(self) -> Transfer:
        """The points as a device file states them, with the phase unwrapped."""
        phase_deg = np.degrees(np.unwrap(np.angle(self.value)))
        return Transfer(tuple(self.frequency_hz.tolist()), tuple(abs(self.value).tolist()), tuple(phase_deg.tolist()))


def find_transfers(device: Device, measurements: Measurements) -> tuple[FoundTransfer, ...]:
    """The transfer function of every actuator, from complex responses of each alone; the device's own ones are ignored.

    Raises TransferError for peaks, for a finger on the bar, and where too few frequencies are left.
    """
    if measurements.kind is not Kind.RESPONSE:
        raise TransferError("transfer functions need complex responses; these are peaks, without phases")
    if (~np.isnan(measurements.finger_m)).any():
        raise TransferError("transfer functions need the untouched bar; these readings have a finger on it")
    moves = abs(measurements.amplitude) > 0
    if (moves.sum(axis=1) != 1).any():
        raise TransferError("transfer functions need readings of one actuator alone; some move several")
    bare = replace(device, actuators=tuple(replace(each, transfer=None) for each in device.actuators))
    scenarios = sample_scenarios(bare, _BARS, SEED)
    bars = [bare, *(scenarios.device_of(i) for i in range(1, len(scenarios)))]
    modelled = np.exp([MeasurementModel(bar, measurements, ()).predict(np.zeros(0)).log_acceleration for bar in bars])
    return tuple(
        _find_one(device, index, measurements.part(moves[:, index]), modelled[:, moves[:, index]])
        for index in range(len(device.actuators))
    )


def _find_one(device: Device, index: int, readings: Measurements, modelled: Complex) -> FoundTransfer:
    """Of one actuator; modelled (bar, row): what it does to the nominal bar, the first, and to the sampled ones."""
    name, hz = device.actuators[index].name, readings.frequency_hz[:, index]
    every = np.unique(hz)
    rows = [np.flatnonzero(hz == each) for each in every]
    at_enough = [len(np.unique(readings.position_m[row])) >= FEWEST_PLACES for row in rows]
    if np.count_nonzero(at_enough) < FEWEST_POINTS:
        raise TransferError(
            f"{name}: {np.count_nonzero(at_enough)} of {len(every)} frequencies were read at {FEWEST_PLACES} places or "
            f"more; measure {FEWEST_POINTS} frequencies so"
        )
    found = [_fit_places(modelled[:, row], readings.acceleration[row]) for row in rows]
    value, error = (np.array(column) for column in zip(*found, strict=True))
    kept = np.array(at_enough) & (error <= GREATEST_ERROR)
    if np.count_nonzero(kept) < FEWEST_POINTS:
        raise TransferError(
            f"{name}: {np.count_nonzero(kept)} of {len(every)} frequencies give it within "
            f"{100 * GREATEST_ERROR:.0f} %: the bar is not known well enough; calibrate it first, or measure more "
            "frequencies between its resonances"
        )
    return FoundTransfer(every[kept], value[kept], error[kept], every[~kept])


def _fit_places(modelled: Complex, readings: Complex) -> tuple[complex, float]:
    """H over the places, and its standard error relative to it; modelled (bar, place), readings (place,)."""
    by_bar = (modelled.conj() @ readings) / (abs(modelled) ** 2).sum(axis=1)
    value, places = by_bar[0], len(readings)
    distance = (abs(readings - value * modelled[0]) ** 2).sum() / (abs(value * modelled[0]) ** 2).sum()
    spread = (abs(by_bar[1:] / value - 1) ** 2).mean()
    return complex(value), float(np.sqrt(distance / max(places - 1, 1) + spread))
