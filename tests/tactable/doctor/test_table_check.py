"""Tables and kernels: fresh, stale, broken, where kernels are kept; and the layer that costs most is named."""

import ctypes
import re
from pathlib import Path

import pytest

from precompute.builder.code_fingerprint import code_fingerprint
from tactable.doctor.layers import check_layers, measure_layers, wait_text
from tactable.doctor.table_check import check_fast_path, check_kernels, check_tables
from tactable.shipped import find_device
from tests.engine.made_table import write_table
from tests.tools.guard import allowed

DEVICE = find_device("reference-a")


def test_fresh_stale_and_broken_tables_are_told_apart(tmp_path: Path) -> None:
    fresh = write_table(tmp_path / "fresh.nc", DEVICE, code_fingerprint=code_fingerprint())
    stale = write_table(tmp_path / "stale.nc", DEVICE, code_fingerprint="another")
    broken = tmp_path / "broken.nc"
    broken.write_bytes(fresh.read_bytes()[:-100])
    checks = check_tables([fresh, stale, broken])
    delays, checks = (
        [check for check in checks if "delays" in check.name],
        [c for c in checks if "delays" not in c.name],
    )
    assert [(check.passed, check.needed) for check in checks] == [(True, True), (False, False), (False, True)]
    assert f"tactable build reference-a -o {stale}" in checks[1].remedy
    assert [check.finding.split(",")[:2] for check in delays] == [["left 0 us", " right 0 us"]] * 2


def test_kernels_that_are_kept_pass_and_others_say_how(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert "tactable demo" in check_kernels(tmp_path).remedy
    (tmp_path / "steady.nbi").touch()
    assert check_kernels(tmp_path).passed
    monkeypatch.setattr("os.access", lambda *_: False)
    assert "NUMBA_CACHE_DIR" in check_kernels(tmp_path / "nowhere").remedy


def test_the_fast_path_is_made_or_its_compiler_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fast_library: ctypes.CDLL
) -> None:
    assert fast_library is not None
    with allowed("compiles the step"):
        assert check_fast_path(tmp_path / "made").passed
    monkeypatch.setenv("PATH", "")
    check = check_fast_path(tmp_path)
    assert (check.passed, check.needed) == (False, False)
    assert check.remedy.startswith("install one (gcc)")


def test_what_a_finger_waits_for_is_the_sum_and_says_what_is_not_measured(click_table: Path) -> None:
    panel, engine = (8.0, "ASSUMED: usual"), (0.1, "measured: here")
    text = wait_text(panel, engine, 115_200, click_table)
    assert re.fullmatch(
        r"(\d+\.\d) ms: panel 8 \(ASSUMED: usual\) \+ engine 0\.1 \(measured: here\) \+ line 8\.9 \(computed: .*\) "
        r"\+ bar (\d+(?:\.\d+)?) \(SIMULATED: until the threshold, .*bar\.nc\)",
        text,
    )
    whole_ms, bar_ms = (float(number) for number in re.findall(r"^[\d.]+|(?<=bar )[\d.]+", text))
    assert whole_ms == pytest.approx(17.0 + bar_ms, abs=0.1)
    assert wait_text(panel, engine, 115_200, None).startswith("17.0 ms without the bar: ")


@pytest.mark.machine
def test_every_layer_is_measured_and_what_a_slow_line_costs_a_click_is_stated() -> None:
    for bit_rate_hz in (9_600, 115_200):
        layers = {layer.name: layer for layer in measure_layers(bit_rate_hz)}
        assert list(layers) == ["host", "engine", "terminal", "line", "line for a click"]
        assert layers["line"].typical_us == pytest.approx(24 * 10 / bit_rate_hz * 1e6, rel=1e-3)
        for layer in layers.values():
            assert layer.typical_us > 0
            assert layer.slow_us is None or layer.slow_us >= layer.typical_us
        click = layers["line for a click"]
        assert click.typical_us == pytest.approx(103 * 10 / bit_rate_hz * 1e6, rel=1e-3)
        assert "44 weights" in click.what and "from 51500 bit/s on" in click.what
        if bit_rate_hz == 9_600:
            assert check_layers(list(layers.values()))[-1].finding.startswith("the line for a click, ")
