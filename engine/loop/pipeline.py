"""The pipeline from one HID report to the command for the firmware, as one pure step: the project in one file.

The journey of one touch:

1. `Digitizer.decode_report` takes the bytes of the report and gives the touch frame that they complete: every contact
   with its position in the device's logical units. Most devices send a frame in one report, some in several.
2. `FingerTracker.track` gives the fingers of the frame: where each one is on the bar, in metres, and in which zone.
3. `EffectPlayer.take` follows the rules: which zones are felt, which are quiet because a finger rests there, at which
   level, and whether that is a click. These three are what is `wanted`.
4. `Renderer.render` looks the command up: the drive's bytes for a SET, or a click's for a PLAY. Both were computed from
   the table before the run, so nothing is solved or encoded here.

Time alone changes what is wanted, too: an effect ends, a hold begins, or a digitizer falls silent with a finger down
and the watchdog releases it. `due_ns` says when, and `advance` does it.

The pipeline is pure: it reads no clock, waits for nothing and touches no port. The same reports at the same times give
the same commands, so the loop, the simulated rig, the benchmarks and the tests all run this class. The compiled step
(`engine.loop.fast`) computes the same commands sooner; this is the reference that each of its answers is checked
against. The stamps are measurements and decide nothing.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

from engine.device import Device
from engine.effects import EffectPlayer, Effects
from engine.effects.player import DEFAULT_CLICK_NS
from engine.render import Command, Renderer, Rendering
from engine.touch import Digitizer, FingerTracker, Touch, TouchFrame, open_digitizer
from engine.touch.digitizer import RELEASE_AFTER_NS
from engine.touch.sources import Described


class Wanted(NamedTuple):
    """What the fingers are to feel."""

    state: int
    """The state of all zones, as `engine.touch.state_index` numbers it."""
    level_db: float | None
    """Level in every felt zone, dB above the detection threshold; None: no zone is felt."""
    click_ns: int | None
    """When the click began, on the source's time axis; None: what is felt is steady."""


NOTHING = Wanted(0, None, None)


def _no_stamp() -> int:
    return 0


def open_pipeline(
    described: Described,
    device: Device,
    effects: Effects,
    renderer: Renderer,
    stamp_ns: Callable[[], int] = _no_stamp,
    click_length_ns: int = DEFAULT_CLICK_NS,
) -> "Pipeline":
    """The pipeline of a digitizer on a bar with these rules; raises DescriptorError and DigitizerError."""
    digitizer = open_digitizer(described.descriptor, described.vendor_id, described.product_id)
    player = EffectPlayer(effects, len(device.zones), click_length_ns)
    return Pipeline(digitizer, FingerTracker(device, digitizer.surface), player, renderer, stamp_ns)


class Pipeline:
    """Decodes, tracks, plays and renders the reports of one digitizer on one bar.

    Times are nanoseconds on the source's axis and must not decrease. Before each `step` the caller takes what time
    alone brings until then from `advance`. `stamp_ns` reads the clock of the stamps; without it they are 0.
    """

    def __init__(
        self,
        digitizer: Digitizer,
        tracker: FingerTracker,
        player: EffectPlayer,
        renderer: Renderer,
        stamp_ns: Callable[[], int] = _no_stamp,
    ) -> None:
        self.digitizer, self.tracker, self.player, self.renderer = digitizer, tracker, player, renderer
        self.rendering: Rendering | None = None
        """The table that `change_table` brought; None: the pipeline still plays the first."""
        self.wanted = NOTHING
        self.touches: Sequence[Touch] = ()
        """The fingers of the last frame."""
        self.frame: TouchFrame | None = None
        """The frame that the last report completed; None: it completed none."""
        self.frame_ns = self.state_ns = 0
        """Stamps of the last report: its frame was complete; what is wanted was known."""
        self.due_ns: float = math.inf
        """When `advance` has something to do; infinite: time alone changes nothing."""
        self._release_ns: int | None = None  # when the watchdog releases the contacts; None without contacts
        self._stamp_ns = stamp_ns

    @property
    def is_at_rest(self) -> bool:
        """Whether no finger is down and no effect is under way."""
        return self.due_ns == math.inf

    def step(self, report: bytes, time_ns: int) -> Command | None:
        """Take one report as the device sent it; the new command, None where what is wanted stays the same."""
        frame = self.frame = self.digitizer.decode_report(report, time_ns)
        if frame is None:
            return None
        self.frame_ns = self._stamp_ns()
        if not self._follow(frame):
            return None
        self.state_ns = self._stamp_ns()
        return self.command()

    def advance(self, time_ns: int) -> Iterator[Command]:
        """Yield each command that time alone brings by `time_ns`, in order; `wanted` is what that command is for."""
        release_ns = self._release_ns
        if release_ns is not None and release_ns <= time_ns:
            yield from self._advance_effects(release_ns)
            frame = self.digitizer.expire(release_ns)
            if frame is not None and self._follow(frame):
                yield self.command()
        yield from self._advance_effects(time_ns)

    def command(self) -> Command:
        """The command for what is wanted now; it is also wanted again after a change of table."""
        wanted = self.wanted
        return self.renderer.render(wanted.state, wanted.level_db, wanted.click_ns is not None)

    def silence(self) -> Command | None:
        """Want nothing any more, whatever is touched; None where nothing was wanted."""
        if not self.wanted.state:
            return None
        self.wanted = NOTHING
        return self.command()

    def change_table(self, rendering: Rendering) -> None:
        """Render another table from now on. What is wanted stays: the next `command` comes from the new table."""
        self.rendering, self.renderer = rendering, rendering.renderer
        self.tracker = FingerTracker(rendering.device, self.digitizer.surface)
        self.player.click_length_ns = rendering.click_length_ns

    def _follow(self, frame: TouchFrame) -> bool:
        """Take the fingers of a frame; whether something else is wanted."""
        time_ns = frame.time_ns
        self._release_ns = time_ns + RELEASE_AFTER_NS if frame.contacts else None
        touches = self.touches = self.tracker.track(frame)
        if self.player.take(touches, time_ns):
            return self._take_wanted()
        self._note_due()
        return False

    def _advance_effects(self, time_ns: int) -> Iterator[Command]:
        player = self.player
        while player.next_change_ns is not None and player.next_change_ns <= time_ns:
            player.advance(player.next_change_ns)
            if self._take_wanted():
                yield self.command()

    def _take_wanted(self) -> bool:
        self._note_due()
        player = self.player
        wanted = (player.state, player.level_db, player.click_ns)
        if wanted == self.wanted:
            return False
        self.wanted = Wanted(*wanted)
        return True

    def _note_due(self) -> None:
        due_ns, release_ns = self.player.next_change_ns, self._release_ns
        if release_ns is not None and (due_ns is None or release_ns < due_ns):
            due_ns = release_ns
        self.due_ns = math.inf if due_ns is None else due_ns
