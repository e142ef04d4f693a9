"""The levels of a moving surface that count for the last command: under each finger, and in its field. SIMULATED."""

from collections.abc import Sequence

import numpy as np

from base.arrays import Array
from engine.touch import Touch
from tactable.page.judged_commands import Command
from tactable.page.live_bar import LiveBar, Moved
from tactable.page.page_messages import LOWEST_DB, Drive


class BarLevels:
    """A bar and its levels. A click counts by its greatest level since it began, a steady drive by its present one."""

    def __init__(self, bar: LiveBar) -> None:
        self.bar = bar
        self._nothing_db: Array = np.full(bar.field.count, LOWEST_DB)
        self.along_db = self._nothing_db  # shape (point,): the present levels in the field
        self.counted_db = self._nothing_db  # shape (point,): the levels that count for the last command
        self.present_db = dict[int, float]()  # the present level, by contact
        self.felt_db = dict[int, float]()  # the greatest level since the last command, by contact
        self.simulated_db = dict[int, float]()  # the level that counts, by finger of the last command's placement
        self.is_moving = False

    def begin_command(self) -> None:
        """Forget what counted for the command before."""
        self.counted_db = self._nothing_db
        self.felt_db, self.simulated_db = {}, {}

    def move_until(self, until_us: float, touches: Sequence[Touch], command: Command | None) -> None:
        """Let the bar move until then, and take its levels for the command."""
        start_us = self.bar.now_us
        self._take(self.bar.move_until(until_us), start_us, touches, command)

    def _take(self, moved: Moved | None, start_us: float, touches: Sequence[Touch], command: Command | None) -> None:
        self.is_moving = moved is not None
        is_steady = command is not None and command.drive is Drive.STEADY
        if moved is None or command is None:
            self.along_db, self.present_db = self._nothing_db, {}
            self.counted_db = self.along_db if is_steady else self.counted_db
            return
        self.along_db = moved.levels_db
        # After a stall one step may hold several commands: what was before the last one is not that one's.
        counted_db, felt_db = self.bar.greatest_since(max(command.at_us, start_us))
        self.counted_db = moved.power_levels_db if is_steady else np.maximum(self.counted_db, counted_db)
        self.present_db = dict(moved.power_db if is_steady else moved.peak_db)
        is_over = is_steady and self.bar.now_us > command.ended_us
        for touch in touches:
            number = touch.contact_id
            level_db = self.present_db.get(number, LOWEST_DB)
            now_db = level_db if is_steady else felt_db.get(number, LOWEST_DB)
            self.felt_db[number] = max(now_db, self.felt_db.get(number, LOWEST_DB))
            finger = command.fingers.get(number)
            if finger is not None and not is_over:
                self.simulated_db[finger] = level_db if is_steady else self.felt_db[number]
