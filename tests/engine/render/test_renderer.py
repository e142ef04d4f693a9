"""Laws of the command for fingers, a level and a kind."""

from dataclasses import replace
from math import inf

import pytest

from engine.render.board_fit import ChosenBasis
from engine.render.renderer import SILENCE, PlayCommand, RenderedClicks, Renderer
from engine.table import ClickEntry
from engine.touch import Placement
from firmware_link.protocol.messages import Play, decode_body, encode_play_body
from tests.engine.made_clicks import basis_of, click_of, in_zones, made_clicks, number_of, places_of
from tests.engine.made_states import LEVEL_DB
from tests.engine.render.boards import plain_board
from tests.engine.render.made_steady import MadeSteady
from tests.precompute.devices import shipped

REFERENCE = shipped("reference-a")
CAPABILITIES = plain_board()
HELD = ChosenBasis(basis_of(2, 121), {0: 0})
PLACEMENTS = [in_zones(REFERENCE, [0]), in_zones(REFERENCE, [2], [0]), in_zones(REFERENCE, [0, 4])]
CLICKS = [click_of(REFERENCE, placement) for placement in PLACEMENTS]
LEVELS_DB = (20.0, 26.0, inf)


def renderer_of(
    clicks: list[ClickEntry], steady: MadeSteady | None = None, basis: ChosenBasis = HELD, *, refuses: bool = False
) -> Renderer:
    rendered = RenderedClicks(made_clicks(REFERENCE, clicks), basis, refuses)
    return Renderer(CAPABILITIES, steady or MadeSteady(REFERENCE), rendered, LEVELS_DB)


def test_a_click_is_played_from_the_basis_as_loud_as_it_is_wanted() -> None:
    renderer = renderer_of(CLICKS)
    for level_db, amplitude in ((20.0, 10 ** (-6 / 20)), (26.0, 1.0), (inf, 1.0)):
        for placement in PLACEMENTS:
            command = renderer.render(placement, level_db, is_click=True)
            assert isinstance(command, PlayCommand)
            _, message = decode_body(encode_play_body(1, command.click.play, 2))
            assert isinstance(message, Play)
            assert message.weights == (number_of(REFERENCE, placement),) * 2
            assert message.amplitude == pytest.approx(65_535 * amplitude, abs=0.5)
            assert command.click.length_us == 30_000
    assert renderer.not_achieved == 0 and renderer.click_shortfalls == dict.fromkeys(LEVELS_DB, 0)


def test_the_click_of_fingers_between_places_is_that_of_the_nearest() -> None:
    renderer, half_m = renderer_of(CLICKS), places_of(REFERENCE).pitch_m / 2
    expected = renderer.render(PLACEMENTS[1], LEVEL_DB, is_click=True)
    for off_m in (-0.99 * half_m, 0.99 * half_m):
        moved = replace(PLACEMENTS[1], position_m=tuple(at_m + off_m for at_m in PLACEMENTS[1].position_m))
        assert renderer.render(moved, LEVEL_DB, is_click=True) == expected
    beyond = replace(PLACEMENTS[1], position_m=tuple(at_m + 1.01 * half_m for at_m in PLACEMENTS[1].position_m))
    assert renderer.render(beyond, LEVEL_DB, is_click=True) is None


def test_a_click_that_nobody_has_solved_is_unknown_until_it_is_learned_for_just_these_fingers() -> None:
    renderer, placement = renderer_of(CLICKS), Placement((0.08, 0.2, 0.25), (True, False, False))
    assert renderer.render(placement, LEVEL_DB, is_click=True) is None
    assert renderer.fallback(placement, LEVEL_DB) == renderer.render(placement, LEVEL_DB)
    renderer.clicks.learn(click_of(REFERENCE, placement))
    assert isinstance(renderer.render(placement, LEVEL_DB, is_click=True), PlayCommand)
    elsewhere = Placement((0.05, 0.2, 0.25), (True, False, False))
    other_basis = replace(click_of(REFERENCE, elsewhere), basis=basis_of(2, 121, 241))
    renderer.clicks.learn(other_basis)  # of a table before this one
    assert renderer.render(elsewhere, LEVEL_DB, is_click=True) is None
    near = replace(placement, position_m=(0.0801, 0.2, 0.25))
    assert renderer.render(near, LEVEL_DB, is_click=True) is None
    assert renderer.clicks.number == len(CLICKS)


def test_the_earliest_learned_click_is_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("engine.render.renderer.MOST_LEARNED", 2)
    rendered = RenderedClicks(made_clicks(REFERENCE, CLICKS), HELD, refuses=False)
    learned = [in_zones(REFERENCE, [felt], [zone for zone in (0, 2, 4) if zone != felt]) for felt in (0, 2, 4)]
    for placement in learned:
        rendered.learn(click_of(REFERENCE, placement))
    assert [rendered.is_unknown(placement) for placement in learned] == [True, False, False]


def test_a_click_of_a_set_that_the_device_does_not_hold_is_the_steady_drive() -> None:
    other = replace(CLICKS[1], basis=basis_of(2, 121, 241))
    clicks = [replace(CLICKS[0], basis=other.basis), replace(other, basis_set=1)]
    renderer = renderer_of(clicks, basis=ChosenBasis(basis_of(2, 121), {0: 0}))
    assert isinstance(renderer.render(PLACEMENTS[0], LEVEL_DB, is_click=True), PlayCommand)
    steady = renderer.render(PLACEMENTS[1], LEVEL_DB)
    assert renderer.render(PLACEMENTS[1], LEVEL_DB, is_click=True) == steady != SILENCE
    assert renderer.clicks.number == 1


@pytest.mark.parametrize("refuses", [False, True])
def test_what_is_short_of_its_level_is_counted_and_silent_where_it_is_refused(refuses: bool) -> None:
    weak = click_of(REFERENCE, PLACEMENTS[0], level_db=14.0)
    renderer = renderer_of([weak], MadeSteady(REFERENCE, short_of=[0], refuses=refuses), refuses=refuses)
    assert (renderer.render(PLACEMENTS[0], LEVEL_DB, is_click=True) == SILENCE) == refuses
    assert (renderer.render(PLACEMENTS[0], LEVEL_DB) == SILENCE) == refuses
    assert (renderer.not_achieved, renderer.click_shortfalls) == (2, {20.0: 1, 26.0: 1, inf: 0})


def test_only_a_device_that_understands_the_drives_alike_fits() -> None:
    renderer = renderer_of([])
    assert renderer.fits(replace(CAPABILITIES, boot_id=2))
    assert not renderer.fits(replace(CAPABILITIES, frequency_resolution_hz=0.02))
    assert not renderer.fits(replace(CAPABILITIES, full_scales_m=(0.52e-6, 0.6e-6)))
    assert renderer.suits_device_of(renderer_of(CLICKS))
