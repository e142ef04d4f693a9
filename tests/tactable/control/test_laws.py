"""Laws of what programs hold: nothing of it outlasts them, in every state of run and demo, whatever crosses what.

A random sequence of messages, silences, hang-ups, changes of run and changes of table is acted out on virtual time. The
loop takes parts of steps only when it is polled, so that messages cross changes of the run.
"""

import asyncio
import contextlib
from typing import Any

from hypothesis import Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, rule

from engine.effects.rules import ControlStep, SceneSettings
from tactable.control.steps import StepDecoder, StepEncoder
from tactable.shipped import find_device
from tests.tactable.control.virtual import BASE, Program, VirtualSlot, VirtualTime, server_of, settle

LEASE_S = 5.0
PROGRAMS = st.integers(0, 2)
REGION = {"type": "region", "region": ["0 mm", "100 mm"], "rules": [{"on": "touch", "effect": "buzz"}]}
LONG = {"type": "define", "name": "long", "envelope": [["3000 s", "20 dB"]]}


class Control(RuleBasedStateMachine):
    """Three programs and the loop of a demo."""

    @initialize()
    def begin(self) -> None:
        self.loop = VirtualTime()
        self.slot = VirtualSlot()
        self.server = server_of(self.slot)
        self.programs: list[Program | None] = [None] * 3
        self.numbers = [0] * 3
        self.begun = 0
        # By the number of a program: what it holds once the loop has taken all that was sent.
        self.may_sound, self.keeps_quiet = set[int](), set[int]()
        self.wants: dict[int, SceneSettings] = {}
        self.until_s: dict[int, float] = {}

    def act(self, seconds: float = 0.0) -> None:
        async def pass_time() -> None:
            await asyncio.sleep(seconds)
            await settle()

        self.loop.run_until_complete(pass_time())

    def ask(self, index: int, message: dict[str, Any]) -> int | None:
        """Send a message of a program that waits for no answer; its number, None where it waits."""
        program = self.programs[index]
        if program is None:
            program = self.programs[index] = Program()
            self.begun += 1
            self.numbers[index] = self.begun

            async def begin() -> None:
                program.begin(self.server, lease=f"{LEASE_S} s")

            self.loop.run_until_complete(begin())
            self.act()
        if program.is_waiting:
            return None
        program.tell(message)
        number = self.numbers[index]
        self.until_s[number] = self.loop.time() + LEASE_S
        self.act()
        return number

    def end(self, number: int) -> None:
        self.may_sound.discard(number)
        self.keeps_quiet.discard(number)
        self.wants.pop(number, None)
        self.until_s.pop(number, None)

    @rule(index=PROGRAMS, place=st.sampled_from([{"finger": 3}, {"at": "52 mm"}, {"at": "120 mm"}]))
    def trigger(self, index: int, place: dict[str, Any]) -> None:
        self.ask(index, LONG)
        number = self.ask(index, {"type": "trigger", "effect": "long", **place})
        self.may_sound |= set() if number is None else {number}

    @rule(index=PROGRAMS)
    def stop(self, index: int) -> None:
        number = self.ask(index, {"type": "stop"})
        self.may_sound -= {number}

    @rule(index=PROGRAMS, quiet=st.booleans())
    def give_role(self, index: int, quiet: bool) -> None:
        number = self.ask(index, {"type": "role", "finger": 3, "role": "quiet" if quiet else "by rules"})
        if number is not None:
            self.keeps_quiet = self.keeps_quiet | {number} if quiet else set()

    @rule(index=PROGRAMS, on=st.booleans(), uses=st.booleans(), change=st.sampled_from([-6, 0, 3]))
    def set_settings(self, index: int, on: bool, uses: bool, change: int) -> None:
        asked = {"type": "settings", "enabled": on, "rule_file": uses, "level_change": f"{change} dB"}
        number = self.ask(index, asked)
        if number is not None:
            self.wants[number] = SceneSettings(on, uses, float(change))

    @rule(index=PROGRAMS, name=st.sampled_from("abc"), stays=st.booleans())
    def set_region(self, index: int, name: str, stays: bool) -> None:
        self.ask(index, REGION | {"name": name, "stays": stays})

    @rule(index=PROGRAMS)
    def hang_up(self, index: int) -> None:
        program, self.programs[index] = self.programs[index], None
        if program is not None:
            program.hang_up()
            self.act()
            self.end(self.numbers[index])

    @rule(seconds=st.sampled_from([0.7, 2.3, 5.3]))
    def say_nothing(self, seconds: float) -> None:
        self.act(seconds)
        for number in [number for number, until_s in self.until_s.items() if until_s < self.loop.time()]:
            self.end(number)

    @rule()
    def change_run(self) -> None:
        """Another run of the demo: what waits in the slot is taken by that."""
        self.slot.begin_run()
        assert self.slot.player.scene.settings == self.slot.decoder.scene.settings

    @rule(name=st.sampled_from(["reference-a", "reference-t"]))
    def change_table(self, name: str) -> None:
        self.server.adopt(find_device(name))

    @rule()
    def poll(self) -> None:
        self.slot.poll()
        self.act()

    @rule()
    def rest(self) -> None:
        """The loop has taken everything."""
        while self.slot.poll():
            self.act()
        player, scene = self.slot.player, self.slot.decoder.scene
        plays = [finger.play for finger in (*player.fingers.values(), *player.lifted) if finger.play]
        owners = {play.owner for play in plays if play.level_db is not None or play.change_ns is not None}
        assert owners - {None} <= self.may_sound
        assert player.fingers[3].quiet_for <= self.keeps_quiet
        each = self.wants.values()
        change_db = sum(one.level_change_db for one in each)
        wanted = SceneSettings(all(one.is_enabled for one in each), all(one.uses_rule_file for one in each), change_db)
        assert player.scene.settings == wanted
        if not wanted.is_enabled:
            assert not owners and player.wanted.placement is None and player.next_change_ns is None
        whole = StepDecoder()
        for part in StepEncoder().parts(self.server.scene):
            whole.decode(part)
        assert whole.scene == scene  # what changed adds up to the whole

    def teardown(self) -> None:
        with contextlib.closing(self.loop):
            for index in range(3):
                self.hang_up(index)
            self.rest()
            self.loop.run_until_complete(self._remove())
            assert self.slot.player.scene.effects == BASE and self.slot.decoder.scene == ControlStep(
                (), SceneSettings()
            )
            assert len(self.slot.decoder._effects) <= len(BASE.others)

    async def _remove(self) -> None:
        removing = asyncio.ensure_future(self.server.remove_regions())
        while not removing.done():
            self.slot.poll()
            await asyncio.sleep(0)


TestControl = Control.TestCase
# Not made shorter where it fails: that takes minutes, and each step is one of few.
PHASES = (Phase.explicit, Phase.reuse, Phase.generate)
TestControl.settings = settings(
    max_examples=60, stateful_step_count=30, deadline=None, phases=PHASES, report_multiple_bugs=False
)
