"""Where touches come from: the only modules that read reports."""

from typing import Protocol


class Source(Protocol):
    """A touch device as the loop sees it: reports in order, each with an index and a time.

    A source has a time axis of its own, which the digitizer lives on: the clock's for a live device, the recording's
    for a playback, so that a recording played at any speed is assembled as it was recorded. All times are ns.
    """

    @property
    def name(self) -> str:
        """What the device calls itself; "" where it does not say."""

    @property
    def descriptor(self) -> bytes:
        """The HID report descriptor."""

    @property
    def vendor_id(self) -> int:
        """Vendor number, 0 where unknown."""

    @property
    def product_id(self) -> int:
        """Product number, 0 where unknown."""

    @property
    def ended(self) -> bool:
        """No report will come any more: all are read, or the device is gone."""

    @property
    def report_index(self) -> int:
        """Index of the report read last, counted from 0; no meaning before the first."""

    @property
    def report_time_ns(self) -> int:
        """Time of the report read last, on the source's axis; a live device gives the time of its read."""

    def fileno(self) -> int | None:
        """The descriptor to wait on; None for a source that goes by `next_time_ns`."""

    def next_time_ns(self) -> int | None:
        """Clock time at which the next report is due, perhaps past; None for one that cannot be foretold or none."""

    def read(self, now_ns: int) -> bytes | None:
        """The next report that is there at clock time `now_ns`, report ID first where it has one; never blocks."""

    def source_time_ns(self, now_ns: int) -> int:
        """A clock time on the source's axis."""

    def clock_time_ns(self, source_time_ns: int) -> int:
        """A time on the source's axis as clock time."""
