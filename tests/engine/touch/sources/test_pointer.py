"""Laws of pointer events, and of the reports made for sources that are not HID devices."""

import math
from collections.abc import Iterator

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from engine.touch import Contact, DigitizerError, TouchFrame, open_digitizer
from engine.touch.sources.own_reports import MOST_CONTACTS, Axis, ContactReports
from engine.touch.sources.pointer import (
    REPEAT_NS,
    RESOLUTION,
    SILENT_NS,
    Phase,
    PointerEvent,
    PointerFeed,
    PointerSource,
)
from tests.engine.touch.sources.fake_hid import open_pointer_pipe
from tests.engine.touch.sources.test_evdev import frames

MS = 1_000_000
Pipe = tuple[PointerSource, PointerFeed]


@pytest.fixture
def pipe() -> Iterator[Pipe]:
    source, feed = open_pointer_pipe()
    yield source, feed
    feed.close()
    source.close()


def ids(frame: TouchFrame) -> list[int]:
    return [contact.contact_id for contact in frame.contacts]


def test_a_pointer_rests_while_the_page_is_late_and_one_that_it_forgot_is_released_alone(pipe: Pipe) -> None:
    source, feed = pipe
    digitizer = open_digitizer(source.descriptor)
    feed.send(PointerEvent(2, 0.9, 0.5, Phase.DOWN))
    early, late = set[tuple[int, ...]](), set[tuple[int, ...]]()
    for now_ns in range(0, SILENT_NS + REPEAT_NS, REPEAT_NS):
        if now_ns % (SILENT_NS // 2) == 0:
            feed.send(PointerEvent(1, 0.1, 0.5, Phase.MOVE))
        while (report := source.read(now_ns)) is not None:
            frame = digitizer.decode_report(report, now_ns)
            assert frame is not None
            (early if now_ns < SILENT_NS else late).add(tuple(sorted(ids(frame))))
        assert source.next_time_ns() == now_ns + REPEAT_NS
    assert early == {(2,), (1, 2)}
    assert late == {(1, 2), (1,)}


def test_a_page_that_is_gone_releases_everything_and_ends() -> None:
    source, feed = open_pointer_pipe()
    feed.send(PointerEvent(1, 0.1, 0.5, Phase.DOWN))
    feed.send(PointerEvent(2, 0.9, 0.5, Phase.DOWN))
    feed.close()
    assert [ids(frame) for frame in frames(source, 0)] == [[1], [1, 2], [2], []]
    assert source.ended
    assert (source.fileno(), source.next_time_ns()) == (None, None)
    source.close()


@example(math.nan, 0.5, 1)
@given(st.floats(), st.floats(), st.integers(-(2**31), 2**31 - 1))
def test_any_place_is_on_the_bar_or_refused(x: float, y: float, pointer_id: int) -> None:
    source, feed = open_pointer_pipe()
    event = PointerEvent(pointer_id, x, y, Phase.DOWN)
    if math.isfinite(x) and math.isfinite(y):
        feed.send(event)
        (frame,) = frames(source, 0)
        (contact,) = frame.contacts
        assert 0 <= contact.x <= RESOLUTION and 0 <= contact.y <= RESOLUTION
        assert contact.contact_id == pointer_id % 2**32
    else:
        with pytest.raises(DigitizerError, match="two fractions"):
            feed.send(event)
    feed.close()
    source.close()


def test_a_pipe_that_nobody_reads_does_not_block_the_page_and_an_engine_that_is_gone_is_said() -> None:
    source, feed = open_pointer_pipe()
    with pytest.raises(DigitizerError, match="takes no touches"):
        for _ in range(100_000):
            feed.send(PointerEvent(1, 0.5, 0.5, Phase.MOVE))
    assert len(frames(source, 0)) > 1000
    source.close()
    with pytest.raises(DigitizerError, match="start it again"):
        feed.send(PointerEvent(1, 0.5, 0.5, Phase.DOWN))
    feed.close()
    assert (source.ended, source.fileno()) == (True, None)


axes = st.tuples(st.integers(-(2**31), 2**31 - 2), st.integers(1, 2**31), st.none() | st.floats(1, 5000)).map(
    lambda parts: Axis(parts[0], min(parts[0] + parts[1], 2**31 - 1), parts[2])
)
places = st.integers(-(2**31), 2**31)
contacts = st.lists(
    st.builds(Contact, st.integers(0, 2**32 - 1), places, places, st.just(True), st.just(True)),
    unique_by=lambda contact: contact.contact_id,
    min_size=1,
    max_size=MOST_CONTACTS,
)


@given(axes, axes, contacts)
def test_what_is_encoded_is_decoded_clamped_to_the_surface(x: Axis, y: Axis, down: list[Contact]) -> None:
    reports = ContactReports(x, y, contacts=max(2, len(down)), maximum_contacts=2 * MOST_CONTACTS)
    digitizer = open_digitizer(reports.descriptor)
    surface = digitizer.surface
    for length_mm, axis in ((surface.x.extent_mm, x), (surface.y.extent_mm, y)):
        expected = None if axis.length_mm is None else pytest.approx(axis.length_mm, abs=0.01)
        assert length_mm == expected
    frame = digitizer.decode_report(reports.encode(down), 0)
    assert frame is not None
    assert list(frame.contacts) == [
        contact._replace(x=min(max(contact.x, x.minimum), x.maximum), y=min(max(contact.y, y.minimum), y.maximum))
        for contact in down
    ]
    lifted = digitizer.decode_report(reports.encode([contact._replace(tip=False) for contact in down]), MS)
    assert lifted is not None
    assert lifted.contacts == ()


@pytest.mark.parametrize("count", [0, MOST_CONTACTS + 1])
def test_a_report_of_none_or_too_many_contacts_is_refused(count: int) -> None:
    with pytest.raises(ValueError, match=f"contacts is {count}"):
        ContactReports(Axis(0, 1), Axis(0, 1), contacts=count, maximum_contacts=10)
