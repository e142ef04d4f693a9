"""A run without a process or a clock: an event loop on virtual time, and the loop's side of the slot.

Parts of steps wait in the slot until a test polls it, as they do in the pipe to the loop.
"""

import asyncio
import functools
import json
import selectors
from collections import deque
from collections.abc import AsyncIterator, Callable, Coroutine
from typing import Any, ParamSpec, TypeVar

from engine.effects.effect_player import EffectPlayer
from engine.effects.rules import ControlStep, Effects, Outcome, Rule, Trigger, click
from engine.touch import Touch
from tactable.control.control_server import ControlServer
from tactable.control.requests import Scene
from tactable.control.steps import MOST_BYTES, StepDecoder
from tactable.shipped import find_device, named_effects
from tests.tactable.control.messages import HELLO

T = TypeVar("T")
P = ParamSpec("P")
DEVICE = find_device("reference-a")
BASE = Effects((Rule(Trigger.TOUCH, click(20.0)),), tuple(named_effects().values()))
FINGER = Touch(3, 0.05, 0)
FINGERS = [{"finger": 3, "at_m": 0.05, "zone": "I", "region": None}]


class VirtualTime(asyncio.SelectorEventLoop):
    """Time stands still while there is something to do, and jumps to the next timer when there is nothing."""

    def __init__(self) -> None:
        self.now_s = 0.0
        super().__init__(_Selector(self))

    def time(self) -> float:
        return self.now_s


class _Selector(selectors.SelectSelector):
    def __init__(self, loop: VirtualTime) -> None:
        super().__init__()
        self._loop = loop

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        found = super().select(None if timeout is None else 0.0)
        if not found and timeout is not None:
            self._loop.now_s += timeout
        return found


def run_virtual(act: Coroutine[Any, Any, T]) -> T:
    with asyncio.Runner(loop_factory=VirtualTime) as runner:
        return runner.run(act)


def on_virtual_time(test: Callable[P, Coroutine[Any, Any, None]]) -> Callable[P, None]:
    """Make a test of a coroutine, whose arguments are fixtures."""

    @functools.wraps(test)
    def run(*args: P.args, **fixtures: P.kwargs) -> None:
        run_virtual(test(*args, **fixtures))

    return run


class VirtualSlot:
    """The loop: takes parts one at a time into the player of the present run, in which finger 3 rests."""

    def __init__(self, base: Effects = BASE, *, polls: bool = False) -> None:
        self.steps: list[ControlStep] = []
        self.decoder = StepDecoder()
        self._base, self._polls = base, polls
        self._waiting: deque[tuple[bytes, asyncio.Future[Outcome]]] = deque()
        self.begin_run()

    def begin_run(self) -> None:
        self.player = EffectPlayer(self._base)
        self.player.control(self.decoder.scene, 0)
        self.player.take_touches([FINGER], 0)

    async def hand_over(self, part: bytes) -> Outcome:
        assert not self._waiting and len(part) <= MOST_BYTES
        self._waiting.append((part, asyncio.get_running_loop().create_future()))
        outcome = self._waiting[0][1]
        if self._polls:
            await asyncio.sleep(0)
            self.poll()
        return await outcome

    def poll(self) -> bool:
        """Take the part that waits; whether there was one."""
        if not self._waiting:
            return False
        part, outcome = self._waiting.popleft()
        step = self.decoder.decode(part)
        if step is not None:
            self.steps.append(step)
        outcome.set_result(Outcome.DONE if step is None else self.player.control(step, 0))
        return True


class Program:
    """A program whose messages a test sends one by one; what came back is in `said`."""

    def __init__(self, *, reads: bool = True) -> None:
        self.said: list[dict[str, Any]] = []
        self.talk: asyncio.Task[None] | None = None
        self._lines: asyncio.Queue[bytes | None] = asyncio.Queue()
        self._reads, self._unread = reads, 0
        self._asked = 0

    def begin(self, server: ControlServer, **hello: Any) -> "Program":
        self.talk = asyncio.ensure_future(server.converse(self.lines(), self))
        self.tell(HELLO | hello)
        return self

    def tell(self, message: dict[str, Any] | bytes) -> None:
        self._asked += 1
        self._lines.put_nowait(message if isinstance(message, bytes) else json.dumps(message).encode())

    async def ask(self, *messages: dict[str, Any] | bytes) -> dict[str, Any]:
        """Send these and let all happen that happens without time; what was said last."""
        for message in messages:
            self.tell(message)
        await settle()
        return self.said[-1]

    def hang_up(self) -> None:
        self._lines.put_nowait(None)

    async def lines(self) -> AsyncIterator[bytes]:
        while (line := await self._lines.get()) is not None:
            yield line

    @property
    def answers(self) -> list[dict[str, Any]]:
        return [each for each in self.said if "answer" in each]

    @property
    def is_waiting(self) -> bool:
        """Whether a message has no answer yet."""
        return len(self.answers) < self._asked

    def send(self, line: bytes) -> None:
        self._unread += 0 if self._reads else len(line)
        self.said.append(json.loads(line))

    async def drain(self) -> None:
        await asyncio.sleep(0)

    def unread_bytes(self) -> int:
        return self._unread

    def read_all(self) -> None:
        self._unread = 0


def server_of(slot: VirtualSlot) -> ControlServer:
    return ControlServer(Scene(named_effects()), DEVICE, slot.hand_over, lambda: FINGERS)


async def settle() -> None:
    """Let everything happen that happens without time."""
    for _ in range(20):
        await asyncio.sleep(0)
