"""Devices that build in a second, and folders of them."""

from pathlib import Path

from engine.device import Device
from precompute.measurements.csv import write_csv
from tests.precompute.devices import reference_text
from tests.precompute.measured import read_bar

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
    measured = write_csv(read_bar(Device.parse(true, "true"), {}), Device.read(folder / "device.toml"), "SIMULATED")
    (folder / "measurements.csv").write_text(measured, encoding="utf-8")
