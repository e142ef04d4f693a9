"""Laws of a table with bursts: what it holds, and what firmware without waveforms plays of it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from engine.device import Device
from engine.effects import Effects, Rule, Trigger
from engine.effects.rules import click
from engine.render.prepared import render_table
from engine.render.renderer import DriveCommand
from engine.table import Table
from engine.table.burst import NUMBER_OF_SHAPES
from engine.touch import ZoneState
from firmware_link.emulator.firmware import DeviceConfiguration, EmulatedFirmware
from firmware_link.emulator.synthesis import synthesise
from firmware_link.protocol.messages import FULL_SCALE_WORD, MAGIC, Arm, Features, HelloRequest, Set, SetFlag
from firmware_link.protocol.onset import make_shape
from precompute.builder.build import build_table
from precompute.clicks import onset_design
from precompute.clicks.basis import PLAY_RATE_HZ
from precompute.clicks.burst_table import solve_bursts
from precompute.clicks.design import fingers_of
from precompute.clicks.evaluation import judge_waveform
from precompute.clicks.options import ClickOptions
from precompute.clicks.solver import ClickSolver
from precompute.entries.prediction import touched_zones
from precompute.entries.solver import tabulated_states
from tests.engine.render.test_prepared import capabilities
from tests.firmware_link.virtual_rig import BOOT_ID, BareHost, reference
from tests.precompute.builder.test_build import SMALL

CHEAP = ClickOptions(lengths_s=(0.02,), quiet_db=0.0, scenarios=4, trimmed=10, judged=20)
DEVICE = Device.parse(SMALL, "bar")
LENGTH_S = 0.03
"""Of what is listened to: the burst and its fade."""
FULL = Effects((Rule(Trigger.TOUCH, click(np.inf)),))


def build(path: Path, bursts_up_to: int = 1) -> set[str]:
    """The steps that were told."""
    told = set[str]()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(onset_design, "_GENERATIONS", 2)  # laws, not figures
        build_table(
            DEVICE,
            path,
            created="",
            clicks_up_to=0,
            bursts_up_to=bursts_up_to,
            click_options=CHEAP,
            progress=lambda step, _: told.add(step),
        )
    return told


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bursts") / "bar.nc"
    assert "bursts" in build(path)
    return path


@pytest.fixture(scope="module")
def table(path: Path) -> Table:
    return Table.open(path)


def test_every_state_of_so_many_fingers_has_its_burst(table: Table) -> None:
    states = [state for state in tabulated_states(DEVICE) if len(touched_zones(state)) == 1]
    assert [burst.states for burst in table.bursts] == states
    assert {burst.shape for burst in table.bursts} == set(range(len(table.shapes)))
    assert len(table.shapes) <= NUMBER_OF_SHAPES


def test_what_the_device_plays_is_felt_as_the_table_says(table: Table) -> None:
    """The renderer's bytes, at full scale, to the emulated firmware; what it synthesises, judged."""
    solver = ClickSolver(DEVICE, CHEAP)
    rendering = render_table(table, FULL, capabilities(Features.ONSET_SHAPES))
    for burst in table.bursts:
        command = rendering.renderer.render(burst.index, np.inf, is_click=True)
        assert isinstance(command, DriveCommand) and command.stop_after_ns is not None
        host = BareHost(EmulatedFirmware(DeviceConfiguration(BOOT_ID, bank_capacity_bytes=0)))
        host.send(HelloRequest(MAGIC, 1, 0, 1), 0)
        for index, steps in enumerate(rendering.configuration.onsets):
            host.send(make_shape(index, steps), 0)
        host.send(Arm(BOOT_ID, rendering.configuration.slew_limit_per_s, 100, 0, (FULL_SCALE_WORD,) * 2), 0)
        stop_us = command.stop_after_ns // 1000
        silence = bytes(len(command.drive))
        for drive, onset, now_us in ((command.drive, command.onset, 0), (silence, 0, stop_us)):
            host.send(Set(reference(now_us), SetFlag.WRITE_PHASE, 100, onset, drive), now_us)
        host.firmware.advance(round(LENGTH_S * 1e6))
        played = synthesise(host.firmware.drive_log, 0, LENGTH_S * 1e6, PLAY_RATE_HZ).T
        waveform = played[:, : round(max(CHEAP.lengths_s) * PLAY_RATE_HZ) + 1]
        assert abs(waveform).max() > 0.1
        felt, quiet = (fingers_of(burst.states, kind) for kind in (ZoneState.FELT, ZoneState.QUIET))
        judged = solver.plants_of(touched_zones(burst.states)).judged
        verdict = judge_waveform(waveform, judged, felt, quiet, LENGTH_S)
        assert verdict.felt.low_db == pytest.approx(burst.felt.low_db, abs=0.15)
        assert verdict.felt.nominal_db == pytest.approx(burst.felt.nominal_db, abs=0.15)


def test_bursts_are_taken_over_unless_other_ones_are_wanted(path: Path) -> None:
    assert "bursts as before" in build(path)
    told = build(path.with_name("none.nc"), bursts_up_to=0)
    assert not {"bursts", "bursts as before"} & told
    with Table.open(path.with_name("none.nc")) as none:
        assert none.bursts == ()


def test_bursts_are_the_same_by_however_many_processes(table: Table) -> None:
    options = replace(CHEAP, lengths_s=(0.01,), scenarios=1, trimmed=4, judged=4)
    states, told = [burst.states for burst in table.bursts[:1]], list[float]()
    one, two = (solve_bursts(DEVICE, options, states, workers, told.append) for workers in (1, 2))
    assert one == two
    assert [burst.states for burst in one[0]] == states
    assert told == pytest.approx([0.6, 1.0] * 2)


def test_no_states_are_no_bursts() -> None:
    assert solve_bursts(DEVICE, CHEAP, [], 2, lambda _: None) == ([], ())
