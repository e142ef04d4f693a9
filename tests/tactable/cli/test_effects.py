"""The commands `effects ...`: what they say of a file, what they draw and write, and what they refuse."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from typer.testing import CliRunner, Result

from base.errors import TactableError
from engine.effects.rules import EffectError
from precompute.model.assembly import assemble
from precompute.studies.reach_along import compute_reach
from tactable.cli.main import app
from tactable.cli.options import OptionError
from tactable.shipped import device_folder, find_device

FILES = device_folder().parent / "effects"


def run(*words: str) -> Result:
    return CliRunner().invoke(app, ["effects", *words])


def test_each_event_is_told_with_what_becomes_of_it(tmp_path: Path) -> None:
    done = run("show", str(FILES / "drop.haptic"))
    assert done.exit_code == 0 and "5 events: 3 kept, 2 changed" in done.stdout
    assert "clicks take the place of 30 ms; without curve of the frequency  (amplitude[1..4])" in done.stdout
    found = json.loads(run("show", str(FILES / "drop.haptic"), "--json").stdout)
    assert found["counts"] == {"kept": 3, "changed": 2, "joined": 0, "lost": 0}
    assert found["envelope"][0] == ["11 ms", "quiet"] and found["events"][0]["played"] == "click 24 dB at 11 ms"
    lost = run("show", str(FILES / "drop.haptic"), "--level", "5")
    assert lost.exit_code == 3 and "lost" in lost.stdout
    (tmp_path / "x.ahap").write_text('{"Pattern": 3}', encoding="utf-8")
    assert isinstance(run("show", str(tmp_path / "x.ahap")).exception, EffectError)
    assert isinstance(run("show", str(FILES / "drop.haptic"), "--level", "full").exception, OptionError)


def test_an_effect_is_written_with_the_frequency_of_its_place(tmp_path: Path) -> None:
    path = tmp_path / "error.hjif"
    assert run("show", "error", "-o", str(path), "--device", "reference-a", "--at", "40mm").exit_code == 0
    (perception,) = json.loads(path.read_text(encoding="utf-8"))["perceptions"]
    (device,) = perception["reference_devices"]
    frame = perception["channels"][0]["bands"][0]["effects"][0]["keyframes"][0]
    assert frame["frequency_modulation"] == round(device["resonance_frequency"]) and frame["frequency_modulation"] >= 60
    assert run("show", str(path)).exit_code == 0
    knock = str(FILES / "knock.ahap")
    for words in (["error", "-o", "x.hjif", "--at", "4mm"], [knock, "--device", "reference-a", "--at", "4mm"]):
        assert isinstance(run("show", *words).exception, OptionError)
    assert isinstance(run("show", knock, "-o", "x.ahap").exception, TactableError)
    assert not (tmp_path / "x.hjif").exists()
    unknown = run("show", "nothing", "-o", str(path)).exception
    assert isinstance(unknown, EffectError) and "is neither an effect file nor a named effect" in str(unknown)


def curve_of(*words: str) -> Any:
    done = run("curve", "reference-a", *words)
    assert done.exit_code == 0, done.output
    return json.loads(done.stdout)["places"]


def test_a_curve_is_what_all_actuators_give_the_place_at_full_scale() -> None:
    (place,) = curve_of("--at", "40mm")
    hz, g = zip(*[each.values() for each in place["frequencyToOutputAccelerationMap"]], strict=True)
    device = find_device("reference-a")
    reach = compute_reach(assemble(device), np.array([0.04]), device.finger)
    assert hz == tuple(range(60, 301))
    # The reach also looks between whole frequencies.
    assert 0.9 < max(g) * 9.80665 / reach.one_tone[0] <= 1.0 + 1e-9
    (free,) = curve_of("--at", "40mm", "--no-finger")
    assert max(e["maxOutputAccelerationGs"] for e in free["frequencyToOutputAccelerationMap"]) > max(g)
