"""What the page of a run asks its board to play by hand, for as long as the page goes on asking.

Theory of operation. A browser that drives by hand repeats its sliders every quarter of a second, and the page's process
passes each of them on after it has checked them against the limits of the device. A drive is asked for only until
LEASE_NS after the last of these lines. So a browser that is closed or loses its network, and a page's process that
hangs, end the drive by their silence. The run looks at the lines between two frames: the first one ends the run of the
touches, and once no drive is asked for it begins again. The lease of the drive on the wire is another one, which the
process of the run renews (`tactable.measure.driven_device`).
"""

from typing import Any, Protocol

from base.child import ChildError
from engine.loop import Clock
from tactable.page.hand import HandDrive

LEASE_NS = 1_000_000_000


class Page(Protocol):
    """The page's process, as `base.child.Child` is."""

    def fileno(self) -> int:
        """Readable when it has said something, or has ended."""

    def has_spoken(self) -> bool:
        """Whether `read` would return or raise at once."""

    def read(self) -> dict[str, Any]:
        """The next line. Raises ChildError once it has ended."""

    def write(self, document: dict[str, Any]) -> None:
        """Say a line."""


class AskedByHand:
    """The lines of the page's process. As a StopRequest of the loop it is set once a drive by hand is asked for."""

    def __init__(self, page: Page, clock: Clock) -> None:
        self._page, self._clock = page, clock
        self._hand: HandDrive | None = None
        self._is_there = True
        self.ends_ns = 0
        """When the drive ends unless the page repeats it."""

    def fileno(self) -> int:
        """Readable when the page has said something."""
        return self._page.fileno()

    def is_set(self) -> bool:
        """Whether a drive is asked for now."""
        return self.drive() is not None

    def drive(self) -> HandDrive | None:
        """The drive that is asked for now; None: fingers decide."""
        while self._is_there and self._page.has_spoken():
            try:
                channels = self._page.read()["hand"]
            except ChildError:  # the page has ended; the run goes on
                self._is_there, channels = False, None
            self._hand = None if channels is None else HandDrive(tuple((hz, a, degrees) for hz, a, degrees in channels))
            self.ends_ns = self._clock.now_ns() + LEASE_NS
        if self._clock.now_ns() >= self.ends_ns:
            self._hand = None
        return self._hand

    def tell(self, *, is_driving: bool) -> None:
        """Tell the page whether its drive plays."""
        self._page.write({"driving": is_driving})
