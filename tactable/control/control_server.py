"""The control server: programs that speak, their leases, and one step at a time to the loop.

Theory of operation
-------------------
A program is a connection. Its messages are taken one after another, and each is
answered before the next one is read: a program that floods the channel waits for itself alone. A message that changes
something becomes a control step: the parts that bring the loop up to the scene as it is when the step's turn comes
(`tactable.control.steps`), and what the message asks beside. Parts go to the loop one by one, each after the outcome of
the one before, so that neither many programs nor large scenes queue up in front of the loop.

Each program has a lease, renewed by whatever it sends. A connection that never greets has none, and is closed after
GREET_WITHIN_S. A program that is silent for longer, or whose connection ends, loses what it holds
(`tactable.control.requests`), and the loop gets the step that ends it, whatever the server believes to be under
way: only the loop knows which effects a change of run or a lifted finger has ended. Events are sent as far as a program
takes them: of one that reads too slowly they are dropped and counted, and it is told how many.
"""

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable
from typing import Any, Protocol

from base.points import json_of, point_text
from engine.device import Device
from engine.effects.rules import ControlStep, Outcome, Role, SceneSettings, TriggeredEffect
from tactable.control.requests import (
    VERSION,
    ControlError,
    DefineEffect,
    Hello,
    Ping,
    Region,
    RemoveRegion,
    Request,
    Scene,
    StopRequest,
    Subscribe,
    decode_line,
    read_request,
)
from tactable.control.steps import NOTHING_ASKED, StepEncoder

MOST_PROGRAMS = 16
MOST_UNREAD_BYTES = 262_144  # events are dropped for a program that leaves more than this unread
GREET_WITHIN_S = 10.0  # a connection without a hello for so long is closed, so that it takes no program's place
_GREETING = '{"type": "hello", "version": 1, "name": "my program"}'
HandOver = Callable[[bytes], Awaitable[Outcome]]


class Connection(Protocol):
    """The way back to one program."""

    def send(self, line: bytes) -> None:
        """Send a line; never waits."""

    async def drain(self) -> None:
        """Wait until the program has taken enough of what was sent."""

    def unread_bytes(self) -> int:
        """Number of bytes that were sent and not read yet."""


class _Program:
    """One connected program, and what it holds beside its regions."""

    def __init__(self, number: int, connection: Connection) -> None:
        self.number, self.connection = number, connection
        self.hello: Hello | None = None
        self.streams: frozenset[str] = frozenset()
        self.has_acted = False  # whether it has ever asked for a step: what may be under way then ends with its lease
        self.is_lasting = False  # whether it has triggered an effect without an end, or kept a finger quiet
        self.lost_events = 0
        self.timer: asyncio.TimerHandle | None = None


class ControlServer:
    """All programs. `hand_over` gives a part of a step to the loop and returns its outcome."""

    def __init__(
        self, scene: Scene, device: Device, hand_over: HandOver, fingers: Callable[[], list[dict[str, Any]]]
    ) -> None:
        self.scene = scene
        self._device, self._hand_over, self._fingers = device, hand_over, fingers
        self._programs: dict[int, _Program] = {}
        self._opened = 0
        self._one_step = asyncio.Lock()
        self._encoder = StepEncoder()
        self._endings = set[asyncio.Task[None]]()

    # ---- programs ----

    async def converse(self, lines: AsyncIterator[bytes], connection: Connection) -> None:
        """Answer the messages of one program until it ends; then end what it holds."""
        if len(self._programs) == MOST_PROGRAMS:
            connection.send(_encode(_refusal(None, f"run: {MOST_PROGRAMS} programs are connected: end one of them")))
            return
        self._opened += 1
        program = self._programs[self._opened] = _Program(self._opened, connection)
        try:
            async with asyncio.timeout(GREET_WITHIN_S) as limit:
                async for line in lines:
                    self._renew(program)
                    connection.send(_encode(await self._answer(program, line)))
                    await connection.drain()
                    if program.hello is not None:
                        limit.reschedule(None)
        except TimeoutError:
            text = f"run: no hello within {GREET_WITHIN_S:g} s: the connection is closed"
            connection.send(_encode(_refusal(None, text)))
        finally:
            del self._programs[program.number]
            if program.timer is not None:
                program.timer.cancel()
            await self._end_lease(program)

    def let_go(self, connection: Connection) -> bool:
        """Whether the program at this connection holds nothing; what it triggered then goes on to its own end."""
        program = next(each for each in self._programs.values() if each.connection is connection)
        is_idle = not (program.streams or program.is_lasting or self.scene.is_held_by(program.number))
        program.has_acted &= not is_idle
        return is_idle

    def publish(self, events: Iterable[dict[str, Any]]) -> None:
        """Send events to the programs that want them."""
        for event in events:
            stream, line = event["event"], b""
            for program in self._programs.values():
                if stream in program.streams:
                    line = line or _encode(event)
                    self._send_event(program, line)

    @property
    def wanted_streams(self) -> frozenset[str]:
        """The streams of events that any program wants."""
        return frozenset().union(*(program.streams for program in self._programs.values()))

    def _send_event(self, program: _Program, line: bytes) -> None:
        if program.connection.unread_bytes() > MOST_UNREAD_BYTES:
            program.lost_events += 1
            return
        if program.lost_events:
            program.connection.send(_encode({"event": "lost", "count": program.lost_events}))
            program.lost_events = 0
        program.connection.send(line)

    def adopt(self, device: Device) -> None:
        """Read positions and zones on another device from now on: the run has changed over to its table."""
        self._device = device

    async def remove_regions(self) -> None:
        """Remove the regions of all programs."""
        for name in list(self.scene.regions):
            self.scene.remove_region(name)
        with contextlib.suppress(ControlError):  # the run has ended
            await self._step()

    # ---- leases ----

    def _renew(self, program: _Program) -> None:
        if program.timer is not None:
            program.timer.cancel()
        if program.hello is not None:
            later = asyncio.get_running_loop().call_later
            program.timer = later(program.hello.lease_s, self._expire, program)

    def _expire(self, program: _Program) -> None:
        ending = asyncio.ensure_future(self._end_lease(program))
        self._endings.add(ending)
        ending.add_done_callback(self._endings.discard)
        if program.connection.unread_bytes() <= MOST_UNREAD_BYTES:
            program.connection.send(_encode({"event": "lease ended"}))

    async def _end_lease(self, program: _Program) -> None:
        self.scene.end_lease(program.number)
        if program.has_acted:
            with contextlib.suppress(ControlError):  # the run has ended
                await self._step(ControlStep(gone_owner=program.number))

    # ---- messages ----

    async def _answer(self, program: _Program, line: bytes) -> dict[str, Any]:
        number = None
        try:
            number, values = decode_line(line)
            request = read_request(values, self._device, self.scene.effects, program.number)
            if program.hello is None and not isinstance(request, Hello):
                raise ControlError(f"type: {values['type']!r}: the first message must be a hello: {_GREETING}")
            return {"answer": number, "ok": True, **await self._act(program, request)}
        except ControlError as error:
            return _refusal(number, str(error))

    async def _act(self, program: _Program, request: Request) -> dict[str, Any]:
        """Do what a message asks; the values of its answer. Raises ControlError."""
        scene = self.scene
        program.has_acted |= not isinstance(request, Hello | Subscribe | Ping)
        match request:
            case Hello():
                program.hello = request
                self._renew(program)
                return self._welcome(program)
            case Region():
                scene.set_region(request, program.number)
                await self._step()
            case RemoveRegion():
                scene.remove_region(request.name)
                await self._step()
            case DefineEffect():
                scene.define(request.effect, program.number)
                if request.converted is not None:
                    return {"events": [report.plain() for report in request.converted.reports]}
            case SceneSettings():
                scene.set_settings(program.number, request)
                await self._step()
            case TriggeredEffect():
                program.is_lasting |= request.effect.is_endless
                await self._trigger(request)
            case Role():
                program.is_lasting |= request.is_quiet
                if await self._step(ControlStep(role=request)) is Outcome.NO_FINGER:
                    raise self._no_finger("role.finger", request.contact_id)
            case StopRequest():
                await self._step(ControlStep(stopped_owner=program.number))
            case Subscribe():
                program.streams = request.streams
                return {"fingers": self._fingers()}
            case Ping():
                pass
        return {}

    def _welcome(self, program: _Program) -> dict[str, Any]:
        device, hello = self._device, program.hello
        assert hello is not None
        return {
            "version": VERSION,
            "program": program.number,
            "lease_s": hello.lease_s,
            "device": device.name,
            "length_m": device.surface.length_m,
            "threshold": device.threshold.title,
            "zones": [
                {"name": zone.name, "start_m": json_of(zone.start_m), "stop_m": json_of(zone.stop_m)}
                for zone in device.zones
            ],
            "effects": list(self.scene.effects),
            "regions": list(self.scene.regions),
        }

    async def _trigger(self, request: TriggeredEffect) -> None:
        outcome = await self._step(ControlStep(trigger=request))
        if outcome is Outcome.NO_FINGER:
            raise self._no_finger("trigger.finger", request.contact_id)
        if outcome is Outcome.QUIET:
            text = "trigger.finger: this finger is a palm, or a program keeps it quiet: give it the role 'by rules'"
            raise ControlError(text)
        if outcome is Outcome.OFF:
            raise ControlError("trigger.type: 'trigger': a program has switched feeling off: it must set enabled again")
        if outcome is Outcome.OFF_BAR:
            place = point_text(request.position_m or 0.0)
            raise ControlError(f"trigger.at: {place}: is beyond the surface since its table changed")

    def _no_finger(self, key: str, contact_id: int | None) -> ControlError:
        there = ", ".join(str(each["finger"]) for each in self._fingers()) or "none does"
        return ControlError(f"{key}: {contact_id}: does not touch the bar; of these that do: {there}")

    async def _step(self, act: ControlStep = NOTHING_ASKED) -> Outcome:
        """Bring the loop up to the scene as it is when the turn comes, and do what is asked beside; what became of it.

        A program that hangs up meanwhile does not break it off: the loop would hold half of it.
        """
        return await asyncio.shield(self._hand_over_parts(act))

    async def _hand_over_parts(self, act: ControlStep) -> Outcome:
        async with self._one_step:
            outcomes = [await self._hand_over(part) for part in self._encoder.parts(self.scene, act)]
        return next((outcome for outcome in outcomes if outcome is not Outcome.DONE), Outcome.DONE)


def _refusal(number: int | None, text: str) -> dict[str, Any]:
    return {"answer": number, "ok": False, "error": text}


def _encode(document: dict[str, Any]) -> bytes:
    return json.dumps(document, allow_nan=False).encode() + b"\n"
