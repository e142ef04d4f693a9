"""Laws of the command for what is wanted: at once where it is known, else when its click is learned."""

import pytest

from engine.loop.answerer import NOTHING, Answerer, Wanted
from engine.render import SILENCE, DriveCommand, PlayCommand, Renderer
from engine.render.chosen_basis import ChosenBasis
from engine.render.clicks import RenderedClicks
from engine.table import Clicks
from engine.touch import Placement
from tests.engine.made_clicks import basis_of, click_of, in_zones, made_clicks
from tests.engine.made_states import LEVEL_DB
from tests.engine.render.boards import plain_board
from tests.engine.render.made_steady import MadeSteady
from tests.precompute.devices import shipped

DEVICE = shipped("reference-a")
CAPABILITIES = plain_board()
HELD = ChosenBasis(basis_of(2, 121), {0: 0})
KNOWN, UNKNOWN, MOVED = in_zones(DEVICE, [0]), in_zones(DEVICE, [1], [3, 4]), in_zones(DEVICE, [1], [2, 4])
NOW_NS = 7_000_000


def renderer_of(clicks: Clicks) -> Renderer:
    return Renderer(CAPABILITIES, MadeSteady(DEVICE), RenderedClicks(clicks, HELD, refuses=False), (LEVEL_DB,))


def answerer_of(*, awaits_clicks: bool = True) -> Answerer:
    answerer = Answerer(renderer_of(made_clicks(DEVICE, [click_of(DEVICE, KNOWN)])))
    answerer.awaits_clicks = awaits_clicks
    return answerer


def click_wanted(placement: Placement) -> Wanted:
    return Wanted(placement, LEVEL_DB, NOW_NS)


def test_what_is_known_is_answered_at_once() -> None:
    answerer = answerer_of()
    assert answerer.answer(NOTHING) == SILENCE
    assert isinstance(answerer.answer(click_wanted(KNOWN)), PlayCommand)
    assert isinstance(answerer.answer(Wanted(UNKNOWN, LEVEL_DB, None)), DriveCommand)
    assert answerer.awaited is None


def test_without_a_solver_the_steady_drive_takes_the_place_of_an_unknown_click() -> None:
    answerer = answerer_of(awaits_clicks=False)
    assert isinstance(answerer.answer(click_wanted(UNKNOWN)), DriveCommand) and answerer.awaited is None
    assert isinstance(answerer.answer(click_wanted(KNOWN)), PlayCommand)


def test_an_awaited_click_is_answered_when_it_is_learned() -> None:
    answerer = answerer_of()
    assert answerer.answer(click_wanted(UNKNOWN)) is None and answerer.awaited == UNKNOWN
    assert not answerer.learn(click_of(DEVICE, in_zones(DEVICE, [2], [3, 4])))
    assert answerer.learn(click_of(DEVICE, UNKNOWN)) and answerer.awaited is None
    assert not answerer.learn(click_of(DEVICE, UNKNOWN))
    assert isinstance(answerer.answer_now(click_wanted(UNKNOWN)), PlayCommand)


@pytest.mark.parametrize(
    ("wanted", "awaited"), [(click_wanted(MOVED), MOVED), (Wanted(MOVED, LEVEL_DB, None), None), (NOTHING, None)]
)
def test_after_a_change_of_table_the_click_is_awaited_for_the_fingers_on_its_bar(
    wanted: Wanted, awaited: Placement | None
) -> None:
    answerer, other = answerer_of(), renderer_of(made_clicks(DEVICE, []))
    answerer.change_renderer(other, click_wanted(UNKNOWN))
    assert answerer.awaited is None  # nor was it before
    assert answerer.answer(click_wanted(UNKNOWN)) is None
    answerer.change_renderer(other, wanted)
    assert answerer.awaited == awaited
