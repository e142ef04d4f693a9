"""Maps the pointers of many browsers to the ten fingers of one digitizer."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from engine.touch import DigitizerError
from engine.touch.sources.pointer import SILENT_NS, Phase, PointerEvent, PointerFeed

MOST_FINGERS = 10  # engine.touch.placement.MOST_FINGERS
APART_NS = 150_000_000
"""Time between fingers that come down in a run that has just begun: by then a click has rung down."""


@dataclass
class _Finger:
    """A pressed pointer: contact number, last event, and when its browser sent that.

    is_waiting: it is pressed, and the present run does not know it yet.
    """

    number: int
    event: PointerEvent
    heard_ns: int
    is_waiting: bool = False


class Pointers:
    """Gives each pressed pointer one of ten contact numbers, and forwards its events as reports.

    Fingers that come down in one message are one frame: both feel. Fingers that rest while a run follows another come
    down one after another in it, as they did: the last one feels.
    """

    def __init__(self) -> None:
        self.refused = 0  # count of events that no engine took, and of pointers beyond the tenth
        self._feed: PointerFeed | None = None
        self._fingers: dict[tuple[int, int], _Finger] = {}  # by browser and pointer
        self._next_ns = 0  # when the next finger that waits may come down
        self._frame = list[PointerEvent]()  # fingers that came down and are not handed over yet

    def feed(self, feed: PointerFeed | None) -> None:
        """Send reports to this feed from now on: of a run that has just begun, or to none."""
        self._feed = feed
        for finger in self._fingers.values():
            finger.is_waiting = True

    def take_events(self, browser: int, events: Sequence[PointerEvent], now_ns: int) -> None:
        """Take events of a browser."""
        for event in events:
            self._take((browser, event.pointer_id), event, now_ns)
        self._flush()

    def leave(self, browser: int) -> None:
        """Release all pointers of a browser that disconnected."""
        for key in [key for key in self._fingers if key[0] == browser]:
            self._release(key)

    def bring_down(self, now_ns: int) -> None:
        """Let the next finger that waits come down, and forget those that their browser has lost."""
        for key, finger in list(self._fingers.items()):
            if now_ns - finger.heard_ns > SILENT_NS:
                self._release(key)
        waiting = next((finger for finger in self._fingers.values() if finger.is_waiting), None)
        if waiting is not None and self._feed is not None and now_ns >= self._next_ns:
            waiting.is_waiting, self._next_ns = False, now_ns + APART_NS
            self._send(waiting, replace(waiting.event, phase=Phase.MOVE))

    def _take(self, key: tuple[int, int], event: PointerEvent, now_ns: int) -> None:
        finger = self._fingers.get(key)
        if event.phase in (Phase.UP, Phase.CANCEL):
            if finger is not None:
                finger.event = event
                self._release(key)
            return
        if finger is None:
            taken = {other.number for other in self._fingers.values()}
            number = next((number for number in range(MOST_FINGERS) if number not in taken), None)
            if number is None:
                self.refused += 1
                return
            finger = self._fingers[key] = _Finger(number, event, now_ns)
        finger.event, finger.heard_ns = event, now_ns
        self._send(finger, event)

    def _release(self, key: tuple[int, int]) -> None:
        finger = self._fingers.pop(key)
        self._send(finger, replace(finger.event, phase=Phase.CANCEL))

    def _send(self, finger: _Finger, event: PointerEvent) -> None:
        if finger.is_waiting:
            return
        comes_down = event.phase is Phase.DOWN
        if not comes_down or any(each.pointer_id == finger.number for each in self._frame):
            self._flush()
        self._frame.append(replace(event, pointer_id=finger.number))
        if not comes_down:
            self._flush()

    def _flush(self) -> None:
        frame, self._frame = self._frame, []
        try:
            if self._feed is not None and frame:
                self._feed.send(*frame)
        except DigitizerError:  # the engine is ending, or does not keep up: it is watched elsewhere
            self.refused += len(frame)
