"""The same bar with the same fingers, driven by the paper's method, beside the one that this project drives.

The paper chooses a drive for zones, on the bar without fingers: the greatest share of the energy in the zones where
fingers are to feel, paper eq. (11). That is the row of the table's sweep that a run with drives of zones plays. The
paper has no clicks. Beside a click its row is switched on for as long as the click lasts, within the slew of the
device.
"""

import math
from collections.abc import Sequence

from engine.table.best_rows import BestRows, combination_of
from engine.touch import Touch, ZoneState
from firmware_link.emulator.drive_log import Cause, ChannelTarget, DriveEvent
from firmware_link.emulator.synthesis import US_PER_S
from tactable.page.judged_commands import Command
from tactable.page.live_bar import BarLevels, LiveBar

STEP_US = 30_000  # the second bar takes every second step of the first, which halves what it costs


class PaperBar:
    """A second moving bar, on the time of the first, which plays these rows of a sweep."""

    def __init__(self, first: LiveBar, rows: BestRows) -> None:
        device = first.device
        self.levels = BarLevels(LiveBar(device, first))
        self.rows = rows
        self._device, self._slew_per_s = device, device.limits.slew_per_s
        self._silent = tuple(ChannelTarget(0.0, 0.0, None) for _ in device.actuators)
        self._last_us, self._ends_us = 0.0, math.inf

    def begin_at_rest(self, now_us: float) -> None:
        """Start at rest, as the other bar does."""
        self.levels.bar.begin_at_rest(now_us)
        self._last_us, self._ends_us = now_us, math.inf

    def play(self, command: Command) -> None:
        """Play the row for the zones of a command's felt fingers, for as long as that lasts."""
        self._end_by(command.at_us)
        self.levels.begin_command()
        states = enumerate(command.placement.zone_states(self._device))
        felt = combination_of(zone for zone, state in states if state is ZoneState.FELT)
        row = self.rows.at(felt, command.wanted_db)
        if row is None:
            self.fall_silent(command.at_us)
            return
        drive = zip(row.frequencies_hz, row.amplitudes, row.phases_rad, strict=True)
        self._take(command.at_us, tuple(ChannelTarget(*channel) for channel in drive))
        fall_s = max(row.amplitudes) / self._slew_per_s
        self._ends_us = self._last_us + max(command.length_s - fall_s, 0.0) * US_PER_S

    def fall_silent(self, at_us: float) -> None:
        """End what plays."""
        self._take(at_us, self._silent)
        self._ends_us = math.inf

    def move_until(
        self, until_us: float, touches: Sequence[Touch], command: Command | None, *, is_loaded: bool
    ) -> None:
        """Let the bar move until then, with the fingers of the first bar; less than STEP_US are left for later."""
        if 0 <= until_us - self.levels.bar.now_us < STEP_US:
            return
        self._end_by(until_us)
        self.levels.bar.touch(touches, is_loaded=is_loaded)
        self.levels.move_until(until_us, touches, command)

    def _end_by(self, until_us: float) -> None:
        """End a drive in place of a click that is over by then."""
        if self._ends_us <= until_us:
            self.fall_silent(self._ends_us)

    def _take(self, at_us: float, channels: tuple[ChannelTarget, ...]) -> None:
        # A record may be read after the time of its command: what the bar did until now stays as it was.
        self._last_us = max(at_us, self._last_us, self.levels.bar.now_us)
        event = DriveEvent(math.ceil(self._last_us), Cause.SET, None, self._slew_per_s, channels)
        self.levels.bar.take_events([event])
