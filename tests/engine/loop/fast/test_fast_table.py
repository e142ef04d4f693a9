"""The compiled step's clicks: what is in the arrays, left out, and how small; and its library, made and refused."""

import ctypes
import pickle
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from engine.effects.rules import Effects, Rule, Trigger, click
from engine.loop.fast.fast_layout import NONE, FastTable, with_fast_table
from engine.loop.fast.library import FastPathError, compile_fast_path
from engine.render.renderer import PlayCommand
from engine.touch.placement import Places
from firmware_link.protocol.basis import Basis, BasisSet
from firmware_link.protocol.messages import encode_play
from tests.engine.loop.fast.scripts import LOUD_DB, varied_clicks
from tests.engine.loop.rig import DEVICE, Rig, recording_of, report
from tests.engine.made_clicks import click_of, every_click, made_clicks, places_of
from tests.engine.made_states import LEVEL_DB
from tests.tools.guard import allowed

LEVELS_DB = (LEVEL_DB, LOUD_DB, float("inf"))
EFFECTS = Effects(tuple(Rule(Trigger.TOUCH, click(level_db)) for level_db in LEVELS_DB))
IDLE = recording_of((0.0, report()))


def table_of(rig: Rig) -> FastTable:
    assert rig.rendering.fast_table is not None
    return rig.rendering.fast_table


@pytest.mark.parametrize("refuses", [False, True])
def test_every_click_of_every_level_is_the_one_that_the_renderer_gives(refuses: bool) -> None:
    clicks = varied_clicks(DEVICE)
    rig = Rig(IDLE, effects=EFFECTS, clicks=clicks, refuses=refuses)
    table, refused = table_of(rig), 0
    for level, level_db in enumerate(table.levels_db):
        for row in range(len(clicks)):
            command = rig.renderer.render(clicks[row].placement, level_db, is_click=True)
            basis_set, fraction_bits, count = table.head[row].tolist()
            amplitude = int(table.amplitude[level, row])
            if isinstance(command, PlayCommand):
                weights = table.weights[row, :count].tolist()
                assert encode_play(basis_set, fraction_bits, amplitude, weights) == command.click.play
            else:
                refused += 1
                assert amplitude == NONE
    assert (refused > 0) == refuses


def test_a_set_that_the_device_does_not_hold_is_not_played() -> None:
    clicks = varied_clicks(DEVICE)
    rig = Rig(IDLE, effects=EFFECTS, clicks=clicks)
    rig.renderer.clicks.basis = replace(rig.renderer.clicks.basis, sets={1: 0})
    assert rig.session.link.capabilities is not None
    table = with_fast_table(rig.rendering, rig.session.link.capabilities).fast_table
    assert table is not None
    assert ((table.amplitude == NONE) == (clicks.basis_set == 0)).all()
    assert (table.head[clicks.basis_set == 1, 0] == 0).all()


def test_more_places_or_zones_than_there_is_room_for_take_the_long_way() -> None:
    rig = Rig(IDLE, effects=EFFECTS, clicks=every_click(DEVICE))
    assert rig.session.link.capabilities is not None
    zones = tuple(replace(DEVICE.zones[0], name=str(number)) for number in range(17))
    rendering = replace(rig.rendering, device=replace(DEVICE, zones=zones))
    assert with_fast_table(rendering, rig.session.link.capabilities).fast_table is None
    other = replace(every_click(DEVICE), places=Places(DEVICE.bar.length_m, 1100))
    assert Rig(IDLE, effects=EFFECTS, clicks=other).rendering.fast_table is None


def test_a_click_too_long_for_a_frame_of_one_block_is_left_to_the_loop() -> None:
    placement = places_of(DEVICE).placement((5,))
    few = click_of(DEVICE, placement)
    many = replace(few, weights=np.ones(121, np.int16), basis=_wide_basis(few.basis.sample_rate_hz))
    table = table_of(Rig(IDLE, effects=EFFECTS, clicks=made_clicks(DEVICE, [many])))
    assert (table.amplitude == NONE).all()


def _wide_basis(sample_rate_hz: int) -> Basis:
    return Basis(sample_rate_hz, (BasisSet(np.zeros((121, 11), np.int16), np.arange(121, dtype=np.uint8) % 2),))


def test_what_the_renderer_holds_already_travels_once() -> None:
    rendering = Rig(IDLE, effects=EFFECTS, clicks=varied_clicks(DEVICE)).rendering
    alone = replace(rendering, fast_table=None)
    table, received = rendering.fast_table, pickle.loads(pickle.dumps(rendering))
    assert table is not None
    more = len(pickle.dumps(rendering)) - len(pickle.dumps(alone))
    assert more < table.amplitude.nbytes + table.head.nbytes + 1000
    assert received.fast_table.pair is received.renderer.clicks.clicks.pair


pytestmark = pytest.mark.usefixtures("fast_library")


@pytest.fixture(autouse=True)
def compiler() -> Iterator[None]:
    with allowed("compiles the step"):
        yield


def test_it_is_compiled_once(tmp_path: Path) -> None:
    compile_fast_path(tmp_path)
    (made,) = tmp_path.iterdir()
    before = made.stat().st_mtime_ns
    compile_fast_path(tmp_path)
    assert [path.stat().st_mtime_ns for path in tmp_path.iterdir()] == [before]


def test_without_a_compiler_the_remedy_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    with pytest.raises(FastPathError, match="no C compiler: install one"):
        compile_fast_path(tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("content", [b"no library", b"", None], ids=["no library", "empty", "a link elsewhere"])
def test_another_file_is_compiled_anew(tmp_path: Path, fast_library: ctypes.CDLL, content: bytes | None) -> None:
    compiled = Path(fast_library._name)
    path = tmp_path / compiled.name
    if content is None:
        path.symlink_to(compiled)
    else:
        path.write_bytes(content)
    compile_fast_path(tmp_path)
    assert path.read_bytes() == compiled.read_bytes() and not path.is_symlink()


def test_a_library_without_the_symbols_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A compiler that makes another library stands for a version of it that fits no more."""
    source = tmp_path / "other.c"
    source.write_text("int nothing(void) { return 0; }\n", encoding="ascii")
    monkeypatch.setattr("engine.loop.fast.library.SOURCE", source)
    with pytest.raises(FastPathError, match="fast_wait"):
        compile_fast_path(tmp_path / "cache")
