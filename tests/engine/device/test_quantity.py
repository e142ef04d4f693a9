"""Laws of quantities, whose text becomes the SI number or a clause that says what was expected, and of text files."""

import os
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from engine.device import Device, DeviceError
from engine.device.quantity import _CREDIBLE as CREDIBLE
from engine.device.quantity import _NAMES as KINDS
from engine.device.quantity import QuantityError, interval_text, quantity_text, read_number, read_quantity, read_words
from engine.device.threshold import read_threshold_file
from engine.device.toml_table import MOST_BYTES, MOST_DOTS, TomlTable
from engine.device.uncertainty import FITTED_UNITS
from engine.effects.files.conversion import read_effect_file
from engine.effects.rule_file import read_effects, read_vocabulary
from engine.effects.rules import EffectError
from tests.precompute.devices import shipped

PREFIXES = {"G": 1e9, "M": 1e6, "k": 1e3, "": 1.0, "c": 1e-2, "m": 1e-3, "u": 1e-6, "µ": 1e-6, "μ": 1e-6, "n": 1e-9}
HOSTILE = (
    "5 ** 9 ** 9 m", "1e999 m", "1e308 Gm", "nan m", "1_000 m", "5 m\x00", "5 \N{MATHEMATICAL BOLD SMALL M}",
    "9" * 10_000 + " m", "5 " + "m*" * 5_000 + "m", "5 " + "/s" * 25, " " * 10_000 + "5 m", "",
)  # fmt: skip


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("18.9 kN/m", "N/m", 18900.0),
        ("0.01008 1/ks", "1/s", 1.008e-5),
        ("0.52 µm", "m", 0.52e-6),
        ("0.52 μm", "m", 0.52e-6),  # micro sign, Greek mu
        ("  5mm ", "m", 0.005),
        ("0.045 N·s/m", "N*s/m", 0.045),
        ("16 %", "", 0.16),
        ("1 g_0", "m/s^2", 9.80665),
    ],
)
def test_values_come_out_in_si(text: str, unit: str, value: float) -> None:
    assert read_quantity(text, unit) == pytest.approx(value, rel=1e-15)


@given(st.floats(-1e20, 1e20), st.sampled_from(sorted(PREFIXES)))
def test_a_prefix_multiplies(number: float, prefix: str) -> None:
    assert read_quantity(f"{number!r} {prefix}m/s", "m/s") == pytest.approx(number * PREFIXES[prefix], rel=4e-16)


@given(st.floats(allow_nan=False, allow_infinity=False), st.sampled_from([unit for unit in KINDS if unit]))
def test_a_number_in_the_wanted_unit_is_read_exactly_or_refused_as_beyond_belief(number: float, unit: str) -> None:
    least, most = CREDIBLE.get(unit, (0.0, 1e30))
    if number and not least <= abs(number) <= most:
        with pytest.raises(QuantityError, match=re.escape(f"{least:g} to {most:g} {unit}")):
            read_quantity(f"{number!r} {unit}", unit)
    else:
        assert read_quantity(f"{number!r} {unit}", unit) == number


@pytest.mark.parametrize(
    "text", ["", "nan", "inf", "-Infinity", "1_000", "\u0661", "0x10", "1e31", "1e999", "True", "5 m"]
)
def test_a_plain_number_is_of_decimal_digits_and_finite(text: str) -> None:
    assert read_number(" -1.5e3 ") == -1500.0
    with pytest.raises(QuantityError, match="is no number"):
        read_number(text)


@pytest.mark.parametrize(
    "text", ["x=1", "drift=nan", "drift=1e6", "noise=-1 m", "drops=-1", "drops=1,drops=2", "noise"]
)
def test_words_are_known_given_once_and_within_bounds(text: str) -> None:
    words = {"drift": ("a", "ppm"), "noise": ("b", "m"), "drops": ("c", "number")}
    assert read_words("drift=-40, noise=2 mm,drops=3,", words) == {"a": -40 * 1e-6, "b": 0.002, "c": 3.0}
    with pytest.raises(QuantityError, match=text.split("=")[0]):
        read_words(text, words)


@pytest.mark.parametrize("written", [unit for unit in KINDS if unit])
@pytest.mark.parametrize("wanted", KINDS)
def test_another_kind_is_refused_with_both_kinds_and_the_text(written: str, wanted: str) -> None:
    if written == wanted:
        return
    with pytest.raises(QuantityError) as error:
        read_quantity(f"3.25 {written}", wanted)
    assert f"'3.25 {written}' is {KINDS[written]}" in str(error.value)
    assert f"expected {KINDS[wanted]} such as '1 {wanted or '%'}'" in str(error.value)


NUMBERS: tuple[object, ...] = ("5", "5.0", 5, 5.0, -1, True, None, [], {}, ["5 m"])
UNITS = ("furlong", "barn", "kkm", "M", "e", "exp", "meter_", "degC", "m_0", "PA")
REFUSED: list[tuple[object, str]] = [
    *((text, "has no unit; ") for text in NUMBERS),
    *((f"5 {unit}", f"'5 {unit}' has a unit that is not known ({unit}); ") for unit in UNITS),
    *((text, "") for text in HOSTILE),
]


@pytest.mark.parametrize(("text", "clause"), REFUSED, ids=[repr(text)[:20] for text, _ in REFUSED])
def test_what_has_no_unit_or_no_known_one_and_hostile_text_is_refused(text: object, clause: str) -> None:
    with pytest.raises(QuantityError, match=re.escape(f"{clause}expected a length such as '1 m'")):
        read_quantity(text, "m")


@given(st.sampled_from(sorted(set(FITTED_UNITS.values()))), st.floats(0, 1))
def test_a_device_file_reads_what_is_written(unit: str, share: float) -> None:
    least, most = CREDIBLE[unit]
    value = min(max(least ** (1 - share) * most**share, 1.001 * least), 0.999 * most)
    assert read_quantity(quantity_text(value, unit, 12), unit) == pytest.approx(value, rel=1e-11)


def test_quantities_are_written_in_the_units_that_people_use() -> None:
    assert quantity_text(18900.0, "N/m") == "18.9 kN/m"
    assert quantity_text(0.52e-6, "m") == "0.52 µm" and quantity_text(0.02, "m") == "20 mm"
    assert interval_text((0.5e-3, 0.0212), "m") == "0.5 to 21.2 mm"
    assert interval_text((70e9, 71.5e9), "Pa") == "70 to 71.5 GPa"
    assert quantity_text(0.045, "N*s/m") == "0.045 N*s/m"


READERS: dict[str, tuple[Callable[[Path], Any], type[ValueError]]] = {
    "device": (Device.read, DeviceError),
    "threshold": (read_threshold_file, DeviceError),
    "rules": (partial(read_effects, device=shipped("reference-a")), EffectError),
    "vocabulary": (read_vocabulary, EffectError),
    "effect file": (partial(read_effect_file, name="mine"), EffectError),
}


@pytest.mark.parametrize("reader", READERS)
def test_a_pipe_a_device_and_a_huge_file_are_refused_before_they_are_read(tmp_path: Path, reader: str) -> None:
    read, family = READERS[reader]
    ending = "hjif" if reader == "effect file" else "toml"
    pipe, endless, huge = (tmp_path / f"{name}.{ending}" for name in ("pipe", "endless", "huge"))
    os.mkfifo(pipe)
    endless.symlink_to("/dev/zero")
    with huge.open("wb") as file:
        file.truncate(MOST_BYTES + 1)
    for path, says in ((pipe, "is not a plain file"), (endless, "is not a plain file"), (huge, "expected at most")):
        with pytest.raises(family) as error:
            read(path)
        assert str(path) in str(error.value) and says in str(error.value)
    with pytest.raises((OSError, family), match="missing"):
        read(tmp_path / f"missing.{ending}")


@pytest.mark.parametrize("line", [
    "{}=1",  # the work of readers of TOML is the square of the parts of a key
    "[{}]",
    '[" ".{}]',
    "x = {{ {} = 1 }}",
])  # fmt: skip
@pytest.mark.parametrize("part", ["a", "1", "''"])
def test_a_key_of_very_many_parts_is_refused_by_its_line_but_not_the_dots_of_numbers(line: str, part: str) -> None:
    assert TomlTable.parse(f"x = [{'0.5, ' * 1000}]", "some.toml").left["x"] == [0.5] * 1000
    TomlTable.parse("\n" + line.format(".".join([part] * 50)), "some.toml")
    with pytest.raises(ValueError, match=rf"some.toml: line 2: .*at most {MOST_DOTS} dots"):
        TomlTable.parse("\n" + line.format(".".join([part] * 400)), "some.toml")


def test_a_whole_number_too_long_to_be_shown_is_refused_as_the_file_is() -> None:
    """Python reads hexadecimal numbers of any length, and writes none of more than 4300 digits into an error."""
    with pytest.raises(DeviceError, match=r"some.toml: line 1: .*whole numbers"):
        Device.parse("name = 0x" + "F" * 5000, "some.toml")
