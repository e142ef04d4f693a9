"""Recordings of fingers that move evenly along the virtual touch screen. SIMULATED."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from engine.touch.sources.recording import Recording, Report
from tactable.rig.virtual_digitizer import BUS, DESCRIPTOR, NAME, PRODUCT_ID, VENDOR_ID, report_of

FRAME_S = 0.008


@dataclass(frozen=True)
class Stroke:
    """One finger: down at `start_s` at `start` (fraction of the bar's length), up at `stop_s` at `stop`."""

    start_s: float
    stop_s: float
    start: float
    stop: float

    def place_at(self, time_s: float) -> float:
        """Position as a fraction of the bar's length."""
        return self.start + (self.stop - self.start) * (time_s - self.start_s) / (self.stop_s - self.start_s)


def make_recording(strokes: Sequence[Stroke]) -> Recording:
    """A recording with a report every 8 ms while a finger is down, and one report after each lift."""
    return Recording(NAME, BUS, VENDOR_ID, PRODUCT_ID, DESCRIPTOR, tuple(_reports(strokes)))


def _reports(strokes: Sequence[Stroke]) -> Iterator[Report]:
    index, down = 0, set[int]()
    for frame in range(round(max(stroke.stop_s for stroke in strokes) / FRAME_S) + 2):
        time_s = frame * FRAME_S
        now = {i for i, stroke in enumerate(strokes) if stroke.start_s <= time_s < stroke.stop_s}
        if shown := sorted(now | down):
            fingers = [(i, i in now, strokes[i].place_at(min(time_s, strokes[i].stop_s))) for i in shown]
            yield Report(index, time_s, report_of(fingers, time_s))
            index += 1
        down = now


DEMO_STROKES = (
    Stroke(0.0, 0.8, 0.10, 0.10),  # one finger, zone I
    Stroke(1.0, 1.8, 0.50, 0.50),  # zone III
    Stroke(2.0, 3.6, 0.01, 0.99),  # a stroke along the whole bar
    Stroke(3.9, 5.2, 0.10, 0.10),  # I, then III, then V come down; V leaves first
    Stroke(4.1, 5.2, 0.50, 0.50),
    Stroke(4.3, 4.9, 0.90, 0.90),
    Stroke(5.5, 6.5, 0.30, 0.30),  # II and IV together
    Stroke(5.5, 6.5, 0.70, 0.70),
)
"""The strokes of the shipped recording: taps, a stroke along the bar, and several fingers coming and going."""
