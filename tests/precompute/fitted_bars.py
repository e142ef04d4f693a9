"""The public measured bars fitted as `calibrate` fits them: modes first, then responses."""

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from base.arrays import Array, Complex
from engine.device import Device
from precompute.calibration.calibrate import Calibration, calibrate
from precompute.calibration.modal_fit import ModalCalibration, calibrate_modes
from precompute.measurements.mat import arrays_to_measurements, load_content
from precompute.measurements.measured_modes import parse_modes
from precompute.measurements.measurement_file import read_measurements
from precompute.measurements.pick import pick_modes, residues_of, write_modes
from precompute.measurements.types import Measurements
from precompute.model.modal import compute_modes
from tests.precompute.measured_bars import CANTILEVER_HZ, beam, beam_file, cantilever, ruler, ruler_mat

MODAL = ("bar.youngs_modulus", "bar.mass_damping", "bar.stiffness_damping")


@dataclass(frozen=True)
class FittedBar:
    """Readings of a bar, the fit of its modes, and the shapes (mode, place) that were measured at place_m."""

    measurements: Measurements
    fit: ModalCalibration
    place_m: Array
    shape: Complex


def fit_modes(device: Device, read: Measurements, count: int) -> FittedBar:
    """Pick the first modes of a file with their shapes, write and read them, and fit the device to them."""
    picked = pick_modes(read, device.name)[:count]
    found = residues_of(read, picked, device.name)
    text = write_modes(picked, read, device.name, (found.position_m.real, found.value))
    fit = calibrate_modes(device, parse_modes(text, device, 0.0, device.name), MODAL, starts=1)
    return FittedBar(read, fit, found.position_m.real, found.value)


@cache
def fitted_beam() -> FittedBar:
    """The free beam and its six modes."""
    with TemporaryDirectory() as folder:
        return fit_modes(beam(), read_measurements(beam_file(Path(folder)), beam()), 6)


@cache
def fitted_ruler() -> FittedBar:
    """The ruler and its first four modes; what lies above them is no bending of a free bar."""
    with TemporaryDirectory() as folder:
        path, device = ruler_mat(Path(folder)), ruler()
        return fit_modes(device, arrays_to_measurements(load_content(path), path, device, 0.0), 4)


@cache
def beam_calibration(every: int = 1) -> Calibration:
    """The beam's complex responses, or every so many of them, fitted from where its modes lead."""
    modal = fitted_beam()
    read = modal.measurements.part(np.arange(0, len(modal.measurements), every))
    return calibrate(modal.fit.device, read, (*MODAL, "bar.density"), starts=1)


def cantilever_misses() -> Array:
    """Relative misses (mode,) of the model's first three frequencies."""
    found = compute_modes(cantilever(), np.array([0.5]), 200)[:3]
    misses: Array = np.array([mode.frequency_hz for mode in found]) / CANTILEVER_HZ - 1
    return misses
