"""The JSON schemas of device and rule files have the reader's keys, and refuse only what the reader refuses."""

import copy
import json
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from base.errors import TactableError
from engine.device import Device
from engine.device.named_files import text_with_threshold, text_with_values
from engine.device.toml_table import TomlTable
from engine.effects.rule_file import parse_effects
from tactable.shipped import device_folder, find_device, named_effects

TABLES = Path(__file__).parent.parent / "tables"
DEVICE, EFFECTS = (
    json.loads((TABLES / "schemas" / f"{name}.schema.json").read_text()) for name in ("device", "effects")
)
ZONES = """
[[zone]]
name = "one"
start = "0 %"
stop = "50 %"
"""
PLATE_RULES = """
[[effect]]
name = "all"
envelope = [["click", "20 dB"]]
[[rule]]
on = "drag"
effect = "all"
every = "1 mm"
along = "y"
region = ["45 x 20 mm", ["60 %", "50 mm"]]
"""
TOGETHER = (
    *("damping", "stiffness", "impedance"),  # of the finger: another key may make up for each
    *("measured_hz", "force_n", "forces_n", "forces_db"),
    *("after", "every", "count", "rows", "columns", "zone", "zones", "region"),
)
RULES = """
[[effect]]
name = "all"
envelope = [["click", "20 dB"], ["50 ms", "quiet"], ["held", "full scale"]]
[[rule]]
on = "hold"
effect = "all"
after = "1 s"
zones = ["I"]
[[rule]]
on = "drag"
effect = "all"
every = "1 mm"
region = ["45 mm", "60 %"]
"""
CURVE = "oh-choi-2019.toml"
Path_ = tuple[str | int, ...]


def with_zones() -> str:
    text = find_device("reference-a").text.replace("count = 5 # equal; or [[zone]] tables with name, start, stop\n", "")
    return text.replace('inferred = ["count", "hysteresis"]', "") + ZONES


def with_inertial() -> str:
    changes = {"stiffness": "1.2 kN/m", "full_scale": "50 mN", "kind": "inertial", "moving_mass": "2 g"}
    values = {f"actuator[1].{key}": value for key, value in changes.items()}
    return text_with_values(find_device("reference-a").text, values, "text")


def with_curve_and_impedance() -> str:
    text = text_with_threshold(find_device("reference-a").text, device_folder().parent / "thresholds" / CURVE, "text")
    return text.replace('mass = "0.1 g"\n', "impedance = [[60, 1, -2], [200, 1, -0.7], [300, 1, -0.3]]\n", 1)


def read_device(text: str) -> None:
    Device.parse(text, "text")


def read_rules(text: str) -> None:
    parse_effects(text, "text", find_device("reference-a"), named_effects())


def read_rules_of_a_plate(text: str) -> None:
    parse_effects(text, "text", find_device("reference-p"), named_effects())


CASES = [
    *[(DEVICE, read_device, find_device(name).text) for name in ("reference-a", "reference-d", "reference-t")],
    (DEVICE, read_device, with_zones()),
    (DEVICE, read_device, with_curve_and_impedance()),
    *[(DEVICE, read_device, find_device(name).text) for name in ("reference-p", "reference-c")],
    (DEVICE, read_device, with_inertial()),
    *[(EFFECTS, read_rules, path.read_text()) for path in sorted((TABLES / "effects").glob("*.toml"))],
    (EFFECTS, read_rules_of_a_plate, PLATE_RULES),
    (EFFECTS, read_rules, RULES),
]


def refuses(schema: Any, values: Any) -> bool:
    return not jsonschema.Draft202012Validator(schema).is_valid(values)


@pytest.mark.parametrize(("schema", "read", "text"), CASES)
def test_it_is_a_schema_and_what_is_shipped_is_valid(schema: Any, read: Any, text: str) -> None:
    read(text)
    jsonschema.validate(tomllib.loads(text), schema, jsonschema.Draft202012Validator)


def test_it_has_the_keys_that_the_reader_takes(monkeypatch: pytest.MonkeyPatch) -> None:
    known: dict[str, set[str]] = {}

    def note(self: TomlTable) -> None:
        known.setdefault(f"{type(self).__name__} {self.path.partition('[')[0]}", set()).update(self.known)

    monkeypatch.setattr(TomlTable, "refuse_rest", note)
    for _, read, text in CASES:
        read(text)
    for table, schema in (("DeviceTable", DEVICE), ("RuleTable", EFFECTS)):
        parts = {key: part.get("items", part) for key, part in schema["properties"].items()}
        for key, part in parts.items():
            if "anyOf" in part:  # a name, or a table with keys
                part = schema["$defs"][key]
            if "properties" in part:
                own = "_CurveTable" if key == "threshold" else table
                assert set(part["properties"]) - {"inferred"} == known[f"{own} {key}"], key
    assert set(EFFECTS["properties"]) == known["RuleTable "]
    assert set(DEVICE["properties"]) - {"inferred", "calibration"} == known["DeviceTable "]


def leaves(values: Any, path: Path_ = ()) -> Iterator[Path_]:
    for key, value in values.items() if isinstance(values, dict) else enumerate(values):
        if isinstance(values, dict):
            yield (*path, key)
        if isinstance(value, dict) or (isinstance(value, list) and value and isinstance(value[0], dict)):
            yield from leaves(value, (*path, key))


def changed(values: Any, path: Path_, new: Any) -> Any:
    """A copy with another value, or without it for None."""
    values = copy.deepcopy(values)
    inner = values
    for key in path[:-1]:
        inner = inner[key]
    if new is None:
        del inner[path[-1]]
        if isinstance(inner.get("inferred"), list) and path[-1] in inner["inferred"]:
            inner["inferred"].remove(path[-1])
    else:
        inner[path[-1]] = new
    return values


def inline(value: Any) -> str:
    """TOML of a value in one line: tomlkit takes two thirds of such a test to write it."""
    if isinstance(value, dict):
        return f"{{{', '.join(f'{key} = {inline(inner)}' for key, inner in value.items())}}}"
    return f"[{', '.join(map(inline, value))}]" if isinstance(value, list) else json.dumps(value, ensure_ascii=False)


def is_read(read: Any, values: Any) -> bool:
    try:
        read("\n".join(f"{key} = {inline(value)}" for key, value in values.items()))
    except TactableError:
        return False
    return True


@pytest.mark.parametrize(
    ("schema", "read", "text", "others"),
    [(*CASES[0], ""), (*CASES[3], CASES[0][2]), (*CASES[4], CASES[0][2]), (*CASES[5], CASES[0][2]), (*CASES[-1], "")],
    ids=["device", "zones", "curve", "plate", "rules"],
)
def test_what_it_refuses_the_reader_refuses(schema: Any, read: Any, text: str, others: str) -> None:
    """Keys that the text `others` has, too, are left to the test of that text."""
    values, known = tomllib.loads(text), set(leaves(tomllib.loads(others)))
    for path in (path for path in leaves(values) if path not in known):
        without = changed(values, path, None)
        # Which keys go together, such as `after` with "hold" or an effect with its name, only the reader knows.
        if path[-1] not in TOGETHER and path != ("effect",):
            assert refuses(schema, without) is not is_read(read, without), path
        for new in (7, "7", "seven mm", True, [], ["1 mm"], {"a": 1}, "3 dB", "1 mm", "x"):
            other = changed(values, path, new)
            if refuses(schema, other):
                assert not is_read(read, other), (path, new)
    misspelt = values | {"nmae": "x"}
    assert refuses(schema, misspelt) and not is_read(read, misspelt)
