"""A small table for the figures."""

from pathlib import Path

from engine.device import Device
from precompute.builder.build import build_table
from tests.small_device import small_text


def build_small_table(folder: Path) -> Path:
    """Build it in `folder`."""
    path = folder / "bar.nc"
    build_table(Device.parse(small_text("reference-a"), "bar.toml"), path, created="test", clicks_up_to=0)
    return path
