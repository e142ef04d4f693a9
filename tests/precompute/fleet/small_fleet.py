"""Devices that build in a second, and folders of them."""

from pathlib import Path

import numpy as np

from engine.device import Device
from precompute.measurements.csv import write_csv
from precompute.measurements.simulate import Flaws, even_places, simulate_measurements
from precompute.measurements.types import lay_out
from tests.precompute.devices import reference_text

_CHANGES = {
    'step = "1 Hz"': 'step = "40 Hz"',
    "amplitude_steps = 5": "amplitude_steps = 1",
    "phase_steps = 36": "phase_steps = 4",
    "count = 5": "count = 2",
    '"10 dB", "20 dB", "30 dB"': '"20 dB"',
    'width = "12.7 mm"': 'width = "12.7 mm"\nlargest_element = "20 mm"',
}


def small_text(stiffness: str = "18.9 kN/m") -> str:
    """A coarse reference-a with two zones, its left actuator with this stiffness."""
    return reference_text({**_CHANGES, "18.9 kN/m": stiffness})


def write_unit(folder: Path, text: str) -> Path:
    """A unit's folder with its device.toml."""
    folder.mkdir(parents=True)
    (folder / "device.toml").write_text(text, encoding="utf-8")
    return folder


def write_measurements(folder: Path, true: str) -> None:
    """Measurements of the device that the text `true` describes, for a unit in `folder` that is described otherwise."""
    described = Device.read(folder / "device.toml")
    other = folder / "true.txt"
    other.write_text(true, encoding="utf-8")
    layout = lay_out(np.array([(150.0, 130.0), (150.0, 200.0), (150.0, 230.0)]), even_places(described, 22), 2e-3)
    measured = simulate_measurements(Device.read(other), layout, Flaws(), 0)
    (folder / "measurements.csv").write_text(write_csv(measured, described, "SIMULATED"), encoding="utf-8")
