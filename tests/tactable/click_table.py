"""A small table with clicks: three zones, few plants, one and two fingers at seven places."""

from pathlib import Path

from engine.device import Device
from precompute.builder.build import build_table
from precompute.clicks import ClickOptions
from tests.precompute.builder.test_build import SMALL

CHEAP = ClickOptions(pitch_m=46.6e-3, pool=90, judged=20)
FINGERS = 2


def build_click_table(folder: Path, clicks_up_to: int = FINGERS) -> Path:
    """Build it in `folder`."""
    path = folder / "bar.nc"
    build_table(Device.parse(SMALL, "bar.toml"), path, created="", clicks_up_to=clicks_up_to, click_options=CHEAP)
    return path
