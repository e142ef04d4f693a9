"""A small table for the figures: reference-a with three zones, one level and a coarse sweep."""

from pathlib import Path

from engine.device import Device
from precompute.builder.build import build_table
from tactable.shipped import find_device

_CHANGES = {"count = 5": "count = 3", 'step = "1 Hz"': 'step = "4 Hz"', '"10 dB", "20 dB", "30 dB"': '"20 dB"'}


def build_small_table(folder: Path) -> Path:
    """Build it in `folder`."""
    text = find_device("reference-a").text
    for old, new in _CHANGES.items():
        assert old in text
        text = text.replace(old, new)
    path = folder / "bar.nc"
    build_table(Device.parse(text, "bar.toml"), path, created="test", clicks_up_to=0)
    return path
