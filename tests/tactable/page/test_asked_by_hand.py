"""What a page asks a board to play by hand holds while the page goes on asking, and no longer."""

from collections import deque
from collections.abc import Container, Sequence
from typing import Any

from base.child import ChildError
from tactable.page.asked_by_hand import LEASE_NS, AskedByHand
from tactable.page.hand import HandDrive

ONE, OTHER = [[150.0, 0.2, 0.0]], [[120.0, 0.1, 90.0]]


class Page:
    """A page that has said these lines; an error is its end."""

    def __init__(self) -> None:
        self.said: deque[dict[str, Any] | ChildError] = deque()
        self.heard: list[dict[str, Any]] = []

    def fileno(self) -> int:
        return -1

    def has_spoken(self) -> bool:
        return bool(self.said)

    def read(self) -> dict[str, Any]:
        line = self.said.popleft()
        if isinstance(line, ChildError):
            raise line
        return line

    def write(self, document: dict[str, Any]) -> None:
        self.heard.append(document)


class Clock:
    time_ns = 0

    def now_ns(self) -> int:
        return self.time_ns

    def wait(self, until_ns: int | None, readable: Sequence[int], writable: Sequence[int]) -> Container[int] | None:
        raise AssertionError("it never waits", until_ns, readable, writable)


def asked() -> tuple[AskedByHand, Page, Clock]:
    page, clock = Page(), Clock()
    return AskedByHand(page, clock), page, clock


def test_a_drive_ends_with_its_lease_and_each_line_renews_it() -> None:
    hand, page, clock = asked()
    assert not hand.is_set()
    page.said.append({"hand": ONE})
    assert hand.drive() == HandDrive(((150.0, 0.2, 0.0),))
    clock.time_ns = LEASE_NS - 1
    page.said += [{"hand": ONE}, {"hand": OTHER}]
    assert hand.drive() == HandDrive(((120.0, 0.1, 90.0),)) and hand.ends_ns == 2 * LEASE_NS - 1
    clock.time_ns = 2 * LEASE_NS - 2
    assert hand.is_set()
    clock.time_ns += 1
    assert not hand.is_set()


def test_it_is_given_back_at_once() -> None:
    hand, page, _ = asked()
    page.said += [{"hand": ONE}, {"hand": None}]
    assert not hand.is_set()


def test_a_page_that_has_ended_asks_for_nothing_and_is_not_read_again() -> None:
    hand, page, _ = asked()
    page.said += [{"hand": ONE}, ChildError("the page was ended by SIGKILL"), {"hand": ONE}]
    assert not hand.is_set() and len(page.said) == 1


def test_the_page_hears_whether_its_drive_plays() -> None:
    hand, page, _ = asked()
    hand.tell(is_driving=True)
    assert page.heard == [{"driving": True}]
