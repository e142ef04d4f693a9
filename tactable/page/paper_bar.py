"""The same bar with the same fingers, driven as the paper would drive it, beside the one that this project drives.

The paper chooses a drive for zones, on the bar without fingers: the greatest share of the energy in the zones where
fingers are to feel, paper eq. (11). Here that is its optimum, one frequency for all actuators with their phases, which
is more than the paper's own solver reached. It is played as loud as ours is wanted, within full scale: the amplitude is
chosen for the fingers where they are, which favours the paper too. The paper has no clicks. Beside a click its drive is
switched on for as long as the click lasts, within the slew of the device.
"""

import math
from collections.abc import Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

from engine.device import Device
from engine.touch import Placement, Touch
from engine.touch.finger_tracker import ZoneEdges
from firmware_link.emulator import Cause, ChannelTarget, DriveEvent
from firmware_link.emulator.synthesis import US_PER_S
from precompute.entries.untouched import UntouchedEnergy
from tactable.page.bar_levels import BarLevels
from tactable.page.commands import Command
from tactable.page.live_bar import BarFinger, LiveBar
from tactable.rig.modal_bar import ModalBar

Complex = NDArray[np.complex128]

STEP_US = 30_000
"""The second bar takes every second step of the first, which halves what it costs."""


class PaperDrives:
    """The paper's drives of one device, for fingers at positions."""

    def __init__(self, device: Device) -> None:
        self.device, self._edges = device, ZoneEdges(device)
        self._bar = ModalBar(device)
        self.best_of = cache(UntouchedEnergy.of_modes(self._bar.basis).best_together)
        """The drive for zones, at full scale; each is computed once."""

    def drive_for(self, placement: Placement, level_db: float) -> tuple[float, Complex] | None:
        """Frequency in Hz and amplitudes (actuator,), fractions of full scale; None where no zone is to feel.

        The weakest felt finger gets `level_db`, or as much of it as full scale allows.
        """
        found = (self._edges.zone_at(placement.position_m[finger]) for finger in placement.felt)
        zones = tuple(sorted({zone for zone in found if zone is not None}))
        if not zones:
            return None
        drive = self.best_of(zones)
        frequency_hz = float(drive.frequency_hz[0])
        felt = self._bar.acceleration(frequency_hz, placement.position_m)[list(placement.felt)] @ drive.amplitude
        weakest_db = 20 * np.log10(abs(felt).min() / self.device.threshold.peak_m_per_s2(drive.frequency_hz[:1])[0])
        louder = min(10 ** ((level_db - weakest_db) / 20), self.device.limits.amplitude)
        return frequency_hz, louder * drive.amplitude


class PaperBar:
    """A second moving bar, on the time of the first."""

    def __init__(self, device: Device) -> None:
        self.levels = BarLevels(LiveBar(device))
        self._drives, self._slew_per_s = PaperDrives(device), device.limits.slew_per_s
        self._silent = tuple(ChannelTarget(0.0, 0.0, None) for _ in device.actuators)
        self._last_us, self._ends_us = 0.0, math.inf
        for zone in range(len(device.zones)):  # the commonest ones, before a finger waits for them
            self._drives.best_of((zone,))

    def begin(self, now_us: float) -> None:
        """Start at rest, as the other bar does."""
        self.levels.bar.begin(now_us)
        self._last_us, self._ends_us = now_us, math.inf

    def play(self, command: Command) -> None:
        """Play the paper's drive for the fingers of a command, for as long as that lasts."""
        self._end_by(command.at_us)
        self.levels.begin_command()
        found = self._drives.drive_for(command.placement, command.wanted_db)
        if found is None:
            self.fall_silent(command.at_us)
            return
        frequency_hz, amplitude = found
        channels = tuple(ChannelTarget(frequency_hz, abs(a), math.atan2(a.imag, a.real)) for a in amplitude.tolist())
        self._take(command.at_us, channels)
        fall_s = float(abs(amplitude).max()) / self._slew_per_s
        self._ends_us = self._last_us + max(command.length_s - fall_s, 0.0) * US_PER_S

    def fall_silent(self, at_us: float) -> None:
        """End what plays."""
        self._take(at_us, self._silent)
        self._ends_us = math.inf

    def advance(self, until_us: float, touches: Sequence[Touch], command: Command | None, *, is_loaded: bool) -> None:
        """Let the bar move until then, with the fingers of the first bar; less than STEP_US are left for later."""
        if 0 <= until_us - self.levels.bar.now_us < STEP_US:
            return
        self._end_by(until_us)
        bar = self.levels.bar
        bar.touch([BarFinger(touch.contact_id, touch.position_m) for touch in touches], is_loaded=is_loaded)
        self.levels.advance(until_us, touches, command)

    def _end_by(self, until_us: float) -> None:
        """End a drive in place of a click that is over by then."""
        if self._ends_us <= until_us:
            self.fall_silent(self._ends_us)

    def _take(self, at_us: float, channels: tuple[ChannelTarget, ...]) -> None:
        # A record may be read after the time of its command: what the bar did until now stays as it was.
        self._last_us = max(at_us, self._last_us, self.levels.bar.now_us)
        event = DriveEvent(math.ceil(self._last_us), Cause.SET, None, self._slew_per_s, channels)
        self.levels.bar.take([event])
