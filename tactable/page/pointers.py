"""Pointers of many browsers to the ten fingers of one digitizer."""

from collections.abc import Sequence
from dataclasses import replace

from engine.digitizer import DigitizerError
from engine.sources.pointer import Phase, PointerEvent, PointerFeed

MOST_FINGERS = 10
_MIDDLE = 0.5


class Pointers:
    """Gives each pressed pointer one of ten contact numbers, and hands its events on as reports."""

    def __init__(self) -> None:
        self.refused = 0
        """Events that no engine took, or of pointers beyond the tenth."""
        self._feed: PointerFeed | None = None
        self._numbers: dict[tuple[int, int], int] = {}  # by browser and pointer

    def feed(self, feed: PointerFeed | None) -> None:
        """Where reports go from now on."""
        self._feed = feed

    def take(self, browser: int, events: Sequence[PointerEvent]) -> None:
        """Events of a browser."""
        for event in events:
            self._take(browser, event)

    def leave(self, browser: int) -> None:
        """All pointers of a browser that is gone are released."""
        for pressed, pointer_id in list(self._numbers):
            if pressed == browser:
                self._take(browser, PointerEvent(pointer_id, _MIDDLE, _MIDDLE, Phase.CANCEL))

    def _take(self, browser: int, event: PointerEvent) -> None:
        key = (browser, event.pointer_id)
        is_pressed = event.phase in (Phase.DOWN, Phase.MOVE)
        number = self._numbers.get(key)
        if number is None:
            number = self._free_number() if is_pressed else None
        if number is None:
            self.refused += is_pressed
            return
        if is_pressed:
            self._numbers[key] = number
        else:
            del self._numbers[key]
        self._send(replace(event, pointer_id=number))

    def _free_number(self) -> int | None:
        taken = set(self._numbers.values())
        return next((number for number in range(MOST_FINGERS) if number not in taken), None)

    def _send(self, event: PointerEvent) -> None:
        try:
            if self._feed is not None:
                self._feed.send(event)
        except DigitizerError:  # the engine is ending, or does not keep up: it is watched elsewhere
            self.refused += 1
