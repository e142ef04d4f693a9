"""Laws of the command for what is wanted: at once where it is known, and within the patience where it is awaited."""

from engine.loop.answerer import ANSWER_WITHIN_NS, NOTHING, Answerer, Wanted
from engine.render import SILENCE, DriveCommand, PlayCommand, Renderer
from engine.render.chosen_basis import ChosenBasis
from engine.render.clicks import RenderedClicks
from engine.table import Clicks
from engine.touch import Placement
from engine.touch.places import Places
from tests.engine.made_clicks import basis_of, click_of, in_zones, made_clicks
from tests.engine.made_states import LEVEL_DB
from tests.engine.render.boards import plain_board
from tests.engine.render.made_steady import MadeSteady
from tests.precompute.devices import shipped

DEVICE = shipped("reference-a")
CAPABILITIES = plain_board()
HELD = ChosenBasis(basis_of(2, 121), {0: 0})
KNOWN, UNKNOWN = in_zones(DEVICE, [0]), in_zones(DEVICE, [1], [3, 4])
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
    assert answerer.answer(NOTHING, NOW_NS) == SILENCE
    assert isinstance(answerer.answer(click_wanted(KNOWN), NOW_NS), PlayCommand)
    assert isinstance(answerer.answer(Wanted(UNKNOWN, LEVEL_DB, None), NOW_NS), DriveCommand)
    assert (answerer.awaited, answerer.latest_ns, answerer.is_provisional) == (None, None, False)


def test_without_a_solver_the_steady_drive_takes_the_place_of_an_unknown_click() -> None:
    answerer = answerer_of(awaits_clicks=False)
    assert isinstance(answerer.answer(click_wanted(UNKNOWN), NOW_NS), DriveCommand)
    assert answerer.is_provisional and answerer.awaited is None
    assert isinstance(answerer.answer(click_wanted(KNOWN), NOW_NS), PlayCommand)
    assert not answerer.is_provisional


def test_an_awaited_click_is_answered_when_it_is_learned() -> None:
    answerer = answerer_of()
    assert answerer.answer(click_wanted(UNKNOWN), NOW_NS) is None
    assert (answerer.awaited, answerer.latest_ns) == (UNKNOWN, NOW_NS + ANSWER_WITHIN_NS)
    assert not answerer.learn(click_of(DEVICE, in_zones(DEVICE, [2], [3, 4])))
    assert answerer.learn(click_of(DEVICE, UNKNOWN))
    assert (answerer.awaited, answerer.latest_ns) == (None, None)
    assert isinstance(answerer.answer_now(click_wanted(UNKNOWN)), PlayCommand) and not answerer.is_provisional


def test_a_touch_that_waits_is_answered_also_where_the_next_table_has_no_places_for_its_click() -> None:
    answerer = answerer_of()
    assert answerer.answer(click_wanted(UNKNOWN), NOW_NS) is None
    coarse = Clicks.of(Places.every(DEVICE.bar.length_m, DEVICE.bar.length_m / 2), [])
    answerer.change_renderer(renderer_of(coarse), click_wanted(UNKNOWN))
    assert answerer.awaited is None and answerer.latest_ns == NOW_NS + ANSWER_WITHIN_NS
    assert isinstance(answerer.answer_now(click_wanted(UNKNOWN)), DriveCommand) and answerer.is_provisional
