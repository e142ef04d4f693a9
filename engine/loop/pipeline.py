"""The pipeline from one HID report to the command for the firmware, as one pure step: the project in one file.

The journey of one touch:

1. `Digitizer.decode_report` takes the bytes of the report and gives the touch frame that they complete: every contact
   with its position in the device's logical units. Most devices send a frame in one report, some in several.
2. `FingerTracker.track` gives the fingers of the frame: where each one is on the bar, in metres, and in which zone.
3. `EffectPlayer.take_touches` follows the rules: which fingers are to feel and which are to rest, where each of them
   is, at which level, and whether that is a click. These three are what is `wanted`.
4. `Renderer.render` gives the command: a click of the places nearest to the fingers, looked up in the table, as a PLAY,
   or a steady drive as a SET: solved from the table's modes for the fingers' own positions, or looked up among
   the rows of its sweep for their zones, as the rules say. The `Answerer`
   asks for it: a drive that follows a finger keeps its frequency where it can, and a click that no table holds is
   solved beside the loop and awaited, until `learn` brings it.

A program changes what is wanted between two reports: `control` takes a new set of rules, an effect to begin at a finger
or at a place, or a finger to keep quiet.

Time alone changes what is wanted, too: an effect ends, a hold begins, or a digitizer falls silent with a finger down
and the watchdog releases it. `due_ns` says when, and `commands_due` does it.

The pipeline is pure: it reads no clock, waits for nothing and touches no port. The same steps at the same times give
the same commands, so the loop, the simulated rig, the benchmarks and the tests all run this class. The compiled step
(`engine.loop.fast`) computes the same commands sooner; this is the reference that each of its answers is checked
against. The stamps are measurements and decide nothing.
"""

import math
from collections.abc import Callable, Iterator, Sequence

from engine.device import Device
from engine.effects.effect_player import DEFAULT_CLICK_NS, NOTHING, EffectPlayer, Wanted
from engine.effects.rules import ControlStep, Effects, Outcome
from engine.render.prepared import Rendering
from engine.render.renderer import SILENCE, Command, Renderer
from engine.table import ClickEntry
from engine.touch import Digitizer, FingerTracker, Placement, Touch, TouchFrame, open_digitizer
from engine.touch.debounce import fit_releases
from engine.touch.sources import Described

SAME_FINGER_M = 5e-3  # a finger that is farther away than this from one report to the next is taken for another one
LATEST_NS = 100_000_000  # a click that comes later after its touch feels as a fault: it is not played


def open_pipeline(
    described: Described,
    device: Device,
    effects: Effects,
    renderer: Renderer,
    stamp_ns: Callable[[], int] = lambda: 0,
    click_length_ns: int = DEFAULT_CLICK_NS,
    report_id: int | None = None,
) -> "Pipeline":
    """The pipeline of a digitizer on a bar with these rules; raises DescriptorError and DigitizerError.

    It follows the touch surface of the report `report_id`; None: the one that reports. Without `stamp_ns` stamps are 0.
    """
    digitizer = open_digitizer(described.descriptor, described.vendor_id, described.product_id, report_id)
    return Pipeline(digitizer, device, EffectPlayer(effects, click_length_ns), renderer, stamp_ns)


class Pipeline:
    """Decodes, tracks, plays and renders the reports of one digitizer on one bar.

    Times are nanoseconds on the source's axis and must not decrease. Before each `step` and `control` the caller takes
    what time alone brings until then from `commands_due`. `stamp_ns` reads the clock of the stamps.
    """

    def __init__(
        self,
        digitizer: Digitizer,
        device: Device,
        player: EffectPlayer,
        renderer: Renderer,
        stamp_ns: Callable[[], int],
    ) -> None:
        self.digitizer, self.device, self.player = digitizer, device, player
        self.answerer = Answerer(renderer)
        digitizer.on_surface = self._follow_surface
        self._follow_surface()
        player.change_bar((), device.surface.corner_m)
        self.rendering: Rendering | None = None  # the table that `change_table` brought; None: the first still plays
        self.wanted = NOTHING
        self.effect = ""  # name of the last effect that is wanted or was
        self.touches: Sequence[Touch] = ()  # the fingers of the last frame
        self.frame: TouchFrame | None = None  # the frame that the last report completed; None: it completed none
        self.frame_ns = self.state_ns = 0  # stamps of the last report: its frame was complete; what is wanted was known
        self.due_ns: float = math.inf  # when `commands_due` has something to do; infinite: time alone changes nothing
        self.joined = self.left_out = 0  # fingers joined because they lie too close; fingers beyond the most
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
        return self.answerer.answer(self.wanted)

    def control(self, step: ControlStep, time_ns: int) -> tuple[Outcome, Command | None]:
        """Take what a program asks for; what became of it, and the new command, None where none is due."""
        outcome = self.player.control(step, time_ns)
        return outcome, self.answerer.answer(self.wanted) if self._take_wanted() else None

    def commands_due(self, time_ns: int) -> Iterator[Command]:
        """Yield each command that time alone brings by `time_ns`, in order; `wanted` is what that command is for."""
        while (release_ns := self.digitizer.due_ns) is not None and release_ns <= time_ns:
            yield from self._advance_effects(release_ns)
            frame = self.digitizer.expire(release_ns)
            if frame is not None and self._follow(frame):
                yield from self._answers()
        yield from self._advance_effects(time_ns)
        latest_ns = self.answerer.latest_ns
        if latest_ns is not None and latest_ns <= time_ns:
            self.answerer.stop_waiting()
            self._note_due()

    def command(self) -> Command:
        """The command for what is wanted now; it is also wanted again after a change of table.

        Where the click is not known, it is the steady drive for the same fingers, or silence while it is awaited.
        """
        return SILENCE if self.answerer.awaited is not None else self.answerer.answer_now(self.wanted)

    def learn(self, click: ClickEntry) -> Command | None:
        """Add a click that was solved beside the loop; its command where it is awaited, else None."""
        if not self.answerer.learn(click):
            return None
        self.wanted = self.answerer.wanted_then  # also where the click would be over by now
        self._note_due()
        return self.command()

    def stop_awaiting(self) -> Command | None:
        """Solve no more clicks beside the loop; the command for a touch that waits for one, else None."""
        was_awaited = self.answerer.awaited is not None
        self.answerer.awaits_clicks = False
        self.answerer.stop_waiting()
        return self.command() if was_awaited else None

    def silence(self) -> Command | None:
        """Want nothing any more, whatever is touched; None where nothing was wanted."""
        if self.wanted.placement is None:
            return None
        self.wanted = NOTHING
        self.answerer.stop_waiting()
        self._note_due()
        return self.command()

    def change_table(self, rendering: Rendering) -> None:
        """Render another table from now on; the next `command` comes from it.

        What is wanted stays for the fingers that are on its bar, each where the new touch axis has it.
        """
        device, player = rendering.device, self.player
        self.rendering, self.device = rendering, device
        fit_releases(self.digitizer, device)
        self.touches = self.tracker.change_bar(device)
        player.click_length_ns, player.ahead_ns = rendering.click_length_ns, rendering.click_ahead_ns
        player.change_bar(self.touches, device.surface.corner_m)
        self.wanted = player.wanted
        self.answerer.change_renderer(rendering.renderer, self.wanted)
        self._note_due()

    def _follow_surface(self) -> None:
        """Track the contacts of another surface; the previous surface has no contact down."""
        self.tracker = FingerTracker(self.device, self.digitizer.surface)
        fit_releases(self.digitizer, self.device)

    def _follow(self, frame: TouchFrame) -> bool:
        """Take the fingers of a frame; whether something else is wanted."""
        time_ns = frame.time_ns
        touches = self.touches = self.tracker.track(frame)
        if self.player.take_touches(touches, time_ns):
            return self._take_wanted()
        self._note_due()
        return False

    def _advance_effects(self, time_ns: int) -> Iterator[Command]:
        player = self.player
        while (change_ns := player.next_change_ns) is not None and change_ns <= time_ns:
            player.advance_effects(change_ns)
            if self._take_wanted(is_over=True):
                yield from self._answers()

    def _answers(self) -> Iterator[Command]:
        command = self.answerer.answer(self.wanted)
        if command is not None:
            yield command

    def _take_wanted(self, *, is_over: bool = False) -> bool:
        """Take what the player wants; whether it is something else. is_over: time has ended what was wanted."""
        player = self.player
        if player.wanted == self.wanted:
            self._note_due()
            return False
        self.wanted = player.wanted
        if player.wanted.placement is not None:
            self.effect = player.effect
            self.joined += player.joined > 0
            self.left_out += player.left_out > 0
        if not is_over or player.wanted.placement is not None:  # a click is awaited also beyond its own end
            self.answerer.stop_waiting()
        self._note_due()
        return True

    def _note_due(self) -> None:
        due_ns, release_ns = self.player.next_change_ns, self.digitizer.due_ns
        if release_ns is not None and (due_ns is None or release_ns < due_ns):
            due_ns = release_ns
        latest_ns = self.answerer.latest_ns
        if latest_ns is not None and (due_ns is None or latest_ns < due_ns):
            due_ns = latest_ns
        self.due_ns = math.inf if due_ns is None else due_ns


class Answerer:
    """Finds the command for what is wanted, and waits for one click at a time.

    A steady drive, and a click that the table holds, are answered at once. A click that it does not hold (three fingers
    and more) is *awaited* where clicks are solved beside the loop, which takes some milliseconds. On a machine that is
    busy it may take longer than the click would last: it is played all the same, but not after `patience_ns`. Where
    no process solves it, the steady drive for the same fingers is the answer.
    """

    def __init__(self, renderer: Renderer) -> None:
        self.renderer = renderer
        self.awaits_clicks = False  # whether clicks that are not known are solved beside the loop
        self.patience_ns = LATEST_NS  # for how long after its touch a click is awaited
        self.awaited: Placement | None = None  # the fingers whose click is waited for; None: no click is
        self.wanted_then = NOTHING  # what the click that is awaited is for
        self.latest_ns: int | None = None  # when nothing is waited for any more; None: no click is
        self._held = HeldDrive()

    def answer(self, wanted: Wanted) -> Command | None:
        """The command for what is wanted; None where its click is awaited from now on."""
        command = self._render(wanted)
        if command is None and self.awaits_clicks and wanted.click_ns is not None:
            self.awaited, self.wanted_then = wanted.placement, wanted
            self.latest_ns = wanted.click_ns + self.patience_ns
            return None
        return self._fallback(wanted) if command is None else command

    def answer_now(self, wanted: Wanted) -> Command:
        """The command for what is wanted, without waiting: the steady drive where the click is not known."""
        command = self._render(wanted)
        return self._fallback(wanted) if command is None else command

    def stop_waiting(self) -> None:
        """Await no click any more."""
        self.awaited = self.latest_ns = None

    def learn(self, click: ClickEntry) -> bool:
        """Add a click that was solved beside the loop; whether it was awaited, and is no more."""
        self.renderer.clicks.learn(click)
        if click.placement != self.awaited:
            return False
        self.stop_waiting()
        return True

    def change_renderer(self, renderer: Renderer, wanted: Wanted) -> None:
        """Answer from another table; a click that is awaited is awaited for the fingers on its bar, if it is wanted."""
        self.renderer = renderer
        if self.awaited is not None:
            if wanted.click_ns is None:
                self.stop_waiting()
            else:
                self.awaited, self.wanted_then = wanted.placement, wanted

    def _render(self, wanted: Wanted) -> Command | None:
        placement, level_db, click_ns = wanted
        held_hz = self._held.frequency_for(placement)
        command = self.renderer.render(placement, level_db, click_ns is not None, held_hz)
        self._held.note(placement, command)
        return command

    def _fallback(self, wanted: Wanted) -> Command:
        placement, level_db, _ = wanted
        assert placement is not None and level_db is not None  # only a click may be unknown
        return self.renderer.fallback(placement, level_db)


class HeldDrive:
    """Remembers the steady drive of the fingers, whose frequency the next drive keeps where it can."""

    def __init__(self) -> None:
        self._placement: Placement | None = None
        self._frequency_hz: float | None = None

    def frequency_for(self, placement: Placement | None) -> float | None:
        """The frequency that these fingers have; None where they have no steady drive, or are others."""
        before = self._placement
        if placement is None or before is None or placement.is_felt != before.is_felt:
            return None
        moved_m = (abs(at_m - old_m) for at_m, old_m in zip(placement.position_m, before.position_m, strict=True))
        return self._frequency_hz if max(moved_m) < SAME_FINGER_M else None

    def note(self, placement: Placement | None, command: Command | None) -> None:
        """Take the command that these fingers get now; None: it is awaited."""
        self._frequency_hz = None if command is None else command.frequency_hz
        self._placement = placement
