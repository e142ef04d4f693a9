"""Sources of touch reports: live digitizers, recordings and pointers of a page. No other module reads reports."""

from typing import Protocol

LIFT_ALL = b""  # in place of a report, which is never empty: reports were lost, or the device, and no contact is left


class Described(Protocol):
    """Anything that describes a digitizer: a source or a recording."""

    @property
    def descriptor(self) -> bytes:
        """The HID report descriptor."""

    @property
    def vendor_id(self) -> int:
        """Vendor number, 0 where unknown."""

    @property
    def product_id(self) -> int:
        """Product number, 0 where unknown."""


class Source(Described, Protocol):
    """A touch device as the loop sees it: reports in order, each with an index and a time.

    A source has its own time axis, on which the digitizer works: clock time for a live device, the recording's time for
    a playback. So a recording that is played at any speed is assembled as it was recorded. All times are ns.
    """

    @property
    def name(self) -> str:
        """The device's name for itself, "" where it has none."""

    @property
    def report_id(self) -> int | None:
        """Report of the touch surface that was chosen; None: the one that reports is meant."""

    @property
    def ended(self) -> bool:
        """Whether no further report will come: all are read, or the device is gone."""

    @property
    def report_index(self) -> int:
        """Index of the last report that was read, counted from 0; undefined before the first."""

    @property
    def report_time_ns(self) -> int:
        """Time of the last report that was read, on the source's axis; for a live device the time of the read."""

    def fileno(self) -> int | None:
        """The file descriptor to wait on; None for a source that is driven by `next_time_ns`."""

    def next_time_ns(self) -> int | None:
        """Clock time at which the next report is due, possibly in the past; None: unknown, or no report is due."""

    def read(self, now_ns: int) -> bytes | None:
        """The next available report at clock time `now_ns`, report ID first where it has one; never blocks."""

    def source_time_ns(self, now_ns: int) -> int:
        """Convert clock time to the source's axis."""

    def clock_time_ns(self, source_time_ns: int) -> int:
        """Convert a time on the source's axis to clock time."""


class OnClock:
    """The time axis of a source that has none of its own: the clock's. It has one touch surface."""

    report_id: int | None = None
    vendor_id = product_id = report_time_ns = 0
    report_index = -1

    def source_time_ns(self, now_ns: int) -> int:
        """The clock's time."""
        return now_ns

    def clock_time_ns(self, source_time_ns: int) -> int:
        """The clock's time."""
        return source_time_ns
