"""The layer that costs most is named, with what to do about it."""

import re
from pathlib import Path

import pytest

from tactable.doctor.layers import check_layers, measure_layers, wait_text


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
