"""Scan times of a digitizer, in its own ticks, on the host's time axis."""

from dataclasses import dataclass

SCAN_TIME_TOLERANCE_NS = 25_000_000  # a scan time that is further than this from host time has been reset or wrapped
SCAN_TIME_TICK_NS = 100_000  # HID Usage Tables, 0x0D:0x56; real ones tick each 92 to 131 us


@dataclass(slots=True)
class ScanClock:
    """Moves scan times of the device to the host's time axis.

    Devices reset the counter at a new touch, wrap it at its size instead of the declared maximum, and their ticks of
    100 us are 92..131 us. So only steps of the counter are added up, and only while the sum agrees with host time.
    """

    ticks: int = 0
    time_ns: int = 0

    def advance_scan(self, ticks: int, mask: int, now_ns: int) -> int:
        """Scan time of a frame on the host's axis; host time after a reset or a pause."""
        time_ns = self.time_ns + (ticks - self.ticks & mask) * SCAN_TIME_TICK_NS
        if not -SCAN_TIME_TOLERANCE_NS <= time_ns - now_ns <= SCAN_TIME_TOLERANCE_NS:
            time_ns = now_ns
        self.ticks, self.time_ns = ticks, time_ns
        return time_ns
