"""Moments of the moving bars to be shown slowed, and what each finger felt to be heard, captured after a command."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from engine.touch import Touch
from firmware_link.emulator.synthesis import US_PER_S
from tactable.page.judged_commands import Command
from tactable.page.live_bar import RATE_HZ, LiveBar
from tactable.page.page_messages import Drive, encode_motion, encode_sound

CLICK_MOTION_S = 0.09  # length of the slowed moment of a click: the click, and the ringing after it
STEADY_MOTION_S = 0.04  # two periods of 60 Hz, twelve of 300 Hz
CAPTURE_AFTER_S = 0.4  # a command can be seen slowed and heard this long after it; a steady one is captured repeatedly
HEARD_S = 0.4  # long enough for a pitch; of the past that is kept (KEPT_S)
LOUDER_DB = 12.0  # distance of the wanted level from full scale in a sound
LOUDEST_LEVEL_DB = 40.0  # the wanted level that is assumed for a command at full scale
_MOTION_RATE_HZ = 3000  # ten moments in a period of 300 Hz
_FULL_SCALE = 32_767  # the greatest int16


class Capture:
    """Captures a command, then the newest that came meanwhile."""

    def __init__(self) -> None:
        self._command: Command | None = None
        self._due_us, self._is_captured = math.inf, False
        self._sounds: dict[int, NDArray[np.int16]] = {}

    def begin_command(self, command: Command) -> None:
        """Wait for a command, unless another is waited for that was not captured yet."""
        if self._command is None or self._is_captured:
            self._command, self._due_us = command, command.at_us + CAPTURE_AFTER_S * US_PER_S
            self._is_captured = False

    def take_motion(self, bars: Sequence[LiveBar], touches: Sequence[Touch], newest: Command | None) -> list[bytes]:
        """The MOTION that is due, of bars that show the same moment; sounds are those of the first bar."""
        command, now_us = self._command, bars[0].now_us
        if command is None or now_us < self._due_us:
            return []
        is_click = command.drive is Drive.CLICK
        duration_s = CLICK_MOTION_S if is_click else STEADY_MOTION_S
        since_us = command.at_us if is_click else self._due_us - duration_s * US_PER_S
        every = RATE_HZ // _MOTION_RATE_HZ if is_click else RATE_HZ // _MOTION_RATE_HZ // 2
        contacts = {finger: number for number, finger in command.fingers.items()}
        places_m = enumerate(command.placement.position_m)
        finger_m = [bars[0].place_of(contacts.get(finger), at_m) for finger, at_m in places_m]
        moments = [bar.motion(since_us, duration_s, every, finger_m) for bar in bars]
        self._keep_sounds(command, bars[0], touches)
        self._due_us, self._is_captured = now_us + 1e6, True
        if newest is not None and newest is not command:
            self.begin_command(newest)
        elif now_us >= command.ended_us:
            self._command = None
        motions = [moment for moment in moments if moment is not None]
        if len(motions) < len(bars) or not motions[0].any():
            return []
        size = bars[0].moving.along, bars[0].moving.across
        return [encode_motion(np.stack(motions), size, every / RATE_HZ, command.number, is_click=is_click)]

    def _keep_sounds(self, command: Command, bar: LiveBar, touches: Sequence[Touch]) -> None:
        full_scale_db = LOUDER_DB + (command.wanted_db if math.isfinite(command.wanted_db) else LOUDEST_LEVEL_DB)
        per_threshold = _FULL_SCALE / 10 ** (full_scale_db / 20)
        for touch in touches:
            course = bar.felt(touch.contact_id)
            if course is not None:
                heard = course[-round(HEARD_S * RATE_HZ) :] * per_threshold
                self._sounds[touch.contact_id] = np.clip(np.rint(heard), -_FULL_SCALE, _FULL_SCALE).astype(np.int16)

    def sound(self, finger: int) -> bytes | None:
        """SOUND of the last captured command under a finger; None where the finger felt none."""
        samples = self._sounds.get(finger)
        return None if samples is None else encode_sound(finger, RATE_HZ, samples)
