"""Laws of reading a text file: what may never end is refused by name, and so is what is too large."""

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from engine.device import Device, DeviceError
from engine.device.threshold import read_threshold_file
from engine.device.toml_table import MOST_BYTES, MOST_DOTS, TomlTable
from engine.effects.files.conversion import read_effect_file
from engine.effects.rule_file import read_effects, read_vocabulary
from engine.effects.rules import EffectError
from tests.precompute.devices import shipped

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
