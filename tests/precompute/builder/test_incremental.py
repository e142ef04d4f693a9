"""What a change of the device cannot affect is taken over from the table that is there, and is the same."""

import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from engine.device import Device
from engine.table import Table
from precompute.builder.code_fingerprint import code_fingerprint
from precompute.builder.incremental import (
    BuildOptions,
    Part,
    input_fingerprint,
    is_compatible,
    is_current,
)
from precompute.builder.table_build import build_table
from precompute.clicks import ClickOptions
from tests.precompute.builder.test_table_build import contents
from tests.precompute.fleet.small_fleet import small_text

pytestmark = pytest.mark.long

CHEAP = ClickOptions(pitch_m=93.2e-3, pool=90, judged=20)
TEXT = small_text()
DEVICE = Device.parse(TEXT, "bar")
AS_BEFORE = {part: f"{part} as before" for part in ("responses", "clicks")}


def build(device: Device, path: Path, **options: object) -> set[str]:
    """The steps that were told."""
    told = set[str]()
    wanted = {"clicks_up_to": 1, "click_options": CHEAP} | options
    build_table(device, path, created="", progress=lambda step, _: told.add(step), **wanted)  # type: ignore[arg-type]  # by name
    return told - {"done", "responses"}


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("parts") / "bar.nc"
    build(DEVICE, path)
    return path


@pytest.fixture
def path(built: Path, tmp_path: Path) -> Path:
    return Path(shutil.copy(built, tmp_path / "bar.nc"))


def test_nothing_is_taken_over_under_another_threshold_curve(built: Path) -> None:
    other = DEVICE.with_threshold("android")
    with Table.open(built) as table:
        options = BuildOptions.of(table)
    for part in Part:
        assert input_fingerprint(part, other, options) != input_fingerprint(part, DEVICE, options)
    assert is_compatible(DEVICE, DEVICE) and not is_compatible(DEVICE, other)


CHANGES = {
    "how the digitizer lies": ("flip = false", "flip = true", set(AS_BEFORE)),
    "a word": ("Aluminium bar", "Another bar", set(AS_BEFORE)),
    "the finger": ('stiffness = "1 kN/m"', 'stiffness = "0.9 kN/m"', set[str]()),
    "what is not known of fingers": ('finger = "30 %"', 'finger = "25 %"', {"responses"}),
    "a level": ('"20 dB"', '"12 dB"', set[str]()),
    "the grid": ("phase_steps = 4", "phase_steps = 6", {"clicks"}),
    "zones": ("count = 2", "count = 3", set[str]()),
    "full scale": ('full_scale = "0.52', 'full_scale = "0.6', set[str]()),
}


@pytest.mark.parametrize("change", CHANGES)
def test_a_part_is_computed_again_only_if_what_it_rests_on_has_changed(path: Path, change: str) -> None:
    before, after, kept = CHANGES[change]
    assert before in TEXT
    device = Device.parse(TEXT.replace(before, after), "bar")
    told = build(device, path)
    assert {part for part, step in AS_BEFORE.items() if step in told} == kept
    assert ("sweep" in told) == ("responses" not in kept)
    assert ("clicks" in told) == ("clicks" not in kept)
    Table.open(path, device=device).close()


def test_what_is_taken_over_is_what_would_be_computed(path: Path) -> None:
    device = Device.parse(TEXT.replace('finger = "30 %"', 'finger = "25 %"'), "bar")
    assert AS_BEFORE["responses"] in build(device, path)
    scratch = path.with_name("scratch.nc")
    assert AS_BEFORE["responses"] not in build(device, scratch)
    assert contents(path) == contents(scratch)
    with Table.open(path, device=device) as table:
        assert table.attributes["responses_input_fingerprint"]


def test_a_damaged_table_is_not_taken_over(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    assert not build(DEVICE, path) & set(AS_BEFORE.values())
    Table.open(path, device=DEVICE).close()


def test_a_table_says_what_it_was_built_by_and_is_current_for_its_own_device_and_options_only(path: Path) -> None:
    """Without clicks too, if it was to have none."""
    other = Device.parse(TEXT.replace('stiffness = "18.9', 'stiffness = "19.5'), "bar")
    with Table.open(path) as table:
        options = BuildOptions.of(table)
        assert is_current(table, DEVICE, options) and not is_current(table, other, options)
        assert not is_current(table, DEVICE, replace(options, click_options=replace(CHEAP, quiet_db=1.0)))
    build(DEVICE, path, clicks_up_to=0)
    with Table.open(path) as table:
        options = BuildOptions.of(table)
        assert options == BuildOptions(code_fingerprint(), 0, CHEAP)
        assert is_current(table, DEVICE, options) and not is_current(table, DEVICE, replace(options, clicks_up_to=1))
