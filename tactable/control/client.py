"""The client of the control channel: what a Python program calls to decide who feels what.

`tactable.connect()` gives a `Client` whose calls wait for their answers, `tactable.connect_async()` an `AsyncClient`
whose calls are awaited. Both send the same messages, and keep events until they are asked for.

A program must speak at least once a lease. Every call renews it, and so does waiting for events; a program that
computes for longer calls `ping`, or asks for a longer lease.
"""

import asyncio
import contextlib
import itertools
import json
import os
import select
import socket
import time
from collections import deque
from collections.abc import AsyncIterator, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Self

from base.errors import TactableError
from base.points import point_text
from tactable.control.requests import DEFAULT_LEASE_S, VERSION

_READ_BYTES = 1 << 16
_TIMEOUT_S = 10.0  # a run answers within milliseconds; one that was stopped never does
Document = dict[str, Any]


class ClientError(TactableError):
    """The run refused a message, or cannot be reached; the text says why and what to do."""


def default_socket() -> Path:
    """Address at which a run listens by default."""
    folder = os.environ.get("XDG_RUNTIME_DIR")
    return Path(folder or f"/tmp/tactable-{os.getuid()}") / "tactable-control.sock"


async def connect_async(
    path: Path | str | None = None, *, name: str = "Python", lease_s: float | None = None
) -> "AsyncClient":
    """As `connect`, for a program with an event loop. Raises ClientError."""
    path = default_socket() if path is None else Path(path)
    try:
        reader, writer = await asyncio.open_unix_connection(path)
    except OSError as error:
        raise _unreachable(path, error) from error
    client = AsyncClient(reader, writer)
    try:
        client.run = await client.ask(hello(name, lease_s))
    except BaseException:
        await client.close()
        raise
    return client


def hello(name: str, lease_s: float | None) -> Document:
    """The first message."""
    lease_s = DEFAULT_LEASE_S if lease_s is None else lease_s
    return {"type": "hello", "version": VERSION, "name": name, "lease": f"{lease_s:g} s"}


def region_message(
    name: str,
    place: Sequence[str | complex],
    rules: Mapping[str, str | Mapping[str, Any]],
    enabled: bool,
    level_change: str,
    stays: bool,
) -> Document:
    """A region: `place` is two positions (texts with units, or metres) or names of zones; rules by event."""
    is_zones = all(isinstance(each, str) and not each[:1].isdigit() for each in place)
    where = {"zones": list(place)} if is_zones else {"region": [position_text(each) for each in place]}
    listed = [{"on": on, **({"effect": rule} if isinstance(rule, str) else rule)} for on, rule in rules.items()]
    more = {"enabled": enabled, "level_change": level_change, "stays": stays}
    return {"type": "region", "name": name, **where, "rules": listed, **more}


def trigger_message(effect: str, finger: int | None, at: str | complex | None, level_change: str) -> Document:
    """An effect at a finger, or at a place (a text with a unit, or metres)."""
    message: Document = {"type": "trigger", "effect": effect, "level_change": level_change}
    if finger is not None:
        message["finger"] = finger
    if at is not None:
        message["at"] = position_text(at)
    return message


def position_text(position: str | complex) -> str:
    """A point with its unit; a number is in metres."""
    return position if isinstance(position, str) else point_text(position, 9)


def _unreachable(path: Path, error: OSError) -> ClientError:
    return ClientError(f"{path}: no run listens there ({error}): start one with `tactable run ... --control`")


class Client:
    """One connection, to the run that listens at `path`, or at the default place.

    `run` has what the run says of itself (device, length_m, zones, effects, regions). Every call raises ClientError
    where the run refuses it, and when the run has ended.
    """

    def __init__(
        self, path: Path | str | None = None, *, name: str = "a Python program", lease_s: float | None = None
    ) -> None:
        path = default_socket() if path is None else Path(path)
        self._socket = socket.socket(socket.AF_UNIX)
        try:
            self._socket.connect(str(path))
        except OSError as error:
            self._socket.close()
            raise _unreachable(path, error) from error
        self._received = bytearray()
        self._events = deque[Document]()
        self._numbers = itertools.count()
        self.run: Document = {"lease_s": DEFAULT_LEASE_S}
        try:
            self.run = self.ask(hello(name, lease_s))
        except BaseException:
            self._socket.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *unused: object) -> None:
        self.close()

    def close(self) -> None:
        """Disconnect; what the program holds ends."""
        self._socket.close()

    def fileno(self) -> int:
        """The socket: readable when something has come."""
        return self._socket.fileno()

    def ask(self, message: Document) -> Document:
        """Send any message and wait for its answer."""
        number = next(self._numbers)
        try:
            self._socket.sendall(json.dumps({"id": number, **message}).encode() + b"\n")
        except OSError as error:
            raise ClientError(f"the run has ended ({error})") from error
        until_s = time.monotonic() + _TIMEOUT_S
        while True:
            document = self._read(until_s)
            if document is None:
                raise ClientError(f"no answer for {_TIMEOUT_S:g} s: the run stands still")
            if "event" in document:
                self._events.append(document)
            elif document["answer"] in (number, None):
                return _checked(document)

    def set_region(
        self,
        name: str,
        place: Sequence[str | complex],
        *,
        enabled: bool = True,
        level_change: str = "0 dB",
        stays: bool = False,
        **rules: str | Mapping[str, Any],
    ) -> None:
        """Set or move a region, such as `set_region("ok", ["20 mm", "60 mm"], touch="press", lift="release")`.

        place: two positions, or names of zones. rules: by event, an effect's name or the keys of a rule.
        """
        self.ask(region_message(name, place, rules, enabled, level_change, stays))

    def remove_region(self, name: str) -> None:
        """Remove a region."""
        self.ask({"type": "remove", "name": name})

    def define(self, name: str, envelope: Sequence[Sequence[str]]) -> None:
        """Define an effect by its segments, as in a rule file: `[["click", "20 dB"], ["50 ms", "10 dB"]]`."""
        self.ask({"type": "define", "name": name, "envelope": [list(each) for each in envelope]})

    def define_from_file(self, name: str, path: Path | str, level: str | None = None) -> list[Document]:
        """Define an effect by an effect file, `level` that of its intensity 1 as "25 dB"; what became of its events."""
        path, more = Path(path), {} if level is None else {"level": level}
        try:
            content = json.loads(path.read_text(encoding="utf-8-sig"))
        except (ValueError, RecursionError) as error:
            raise ClientError(f"{path}: is no effect file: {error}") from error
        message = {"type": "define", "name": name, "format": path.suffix.removeprefix(".").lower(), "content": content}
        events: list[Document] = self.ask(message | more)["events"]
        return events

    def trigger(
        self, effect: str, *, finger: int | None = None, at: str | float | None = None, level_change: str = "0 dB"
    ) -> None:
        """Play an effect now, at a finger or at a place."""
        self.ask(trigger_message(effect, finger, at, level_change))

    def stop(self) -> None:
        """End what this program triggered."""
        self.ask({"type": "stop"})

    def keep_quiet(self, finger: int, quiet: bool = True) -> None:
        """Keep a finger quiet until it lifts, or let it follow its rules again."""
        self.ask({"type": "role", "finger": finger, "role": "quiet" if quiet else "by rules"})

    def settings(self, *, enabled: bool = True, rule_file: bool = True, level_change: str = "0 dB") -> None:
        """Settings of the whole bar while this program is connected."""
        self.ask({"type": "settings", "enabled": enabled, "rule_file": rule_file, "level_change": level_change})

    def subscribe(self, *streams: str) -> list[Document]:
        """Ask for events, of "touches" and "played"; returns the fingers that touch now."""
        fingers: list[Document] = self.ask({"type": "subscribe", "to": list(streams)})["fingers"]
        return fingers

    def ping(self) -> None:
        """Renew the lease."""
        self.ask({"type": "ping"})

    def events(self, timeout_s: float | None = None) -> Iterator[Document]:
        """Events as they come, until none has come for `timeout_s`; the lease is renewed meanwhile."""
        while True:
            while self._events:
                yield self._events.popleft()
            if not self._wait_for_event(None if timeout_s is None else time.monotonic() + timeout_s):
                return

    def _wait_for_event(self, until_s: float | None) -> bool:
        while not self._events:
            renew_s = time.monotonic() + self.run["lease_s"] / 3
            document = self._read(renew_s if until_s is None else min(renew_s, until_s))
            if document is not None:
                if "event" in document:
                    self._events.append(document)
            elif until_s is not None and time.monotonic() >= until_s:
                return False
            else:
                self.ping()
        return True

    def _read(self, until_s: float) -> Document | None:
        """The next line; None if none has come by `until_s`."""
        while (end := self._received.find(b"\n")) < 0:
            if not select.select([self._socket], [], [], max(0.0, until_s - time.monotonic()))[0]:
                return None
            data = b""
            with contextlib.suppress(ConnectionResetError):
                data = self._socket.recv(_READ_BYTES)
            if not data:
                raise ClientError("the run has ended")
            self._received += data
        line = bytes(self._received[:end])
        del self._received[: end + 1]
        document: Document = json.loads(line)
        return document


connect = Client


class AsyncClient:
    """One connection of a program with an event loop; `ask` sends any message, and `events` yields what comes.

    `run` is as in `Client`. `region_message` and `trigger_message` make the longer messages.
    """

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.run: Document = {}
        self._writer = writer
        self._numbers = itertools.count()
        self._answers: dict[int, asyncio.Future[Document]] = {}
        self._events: asyncio.Queue[Document | None] = asyncio.Queue()
        self._reading = asyncio.create_task(self._read(reader))

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *unused: object) -> None:
        await self.close()

    async def close(self) -> None:
        """Disconnect; what the program holds ends."""
        self._reading.cancel()
        self._writer.close()

    async def ask(self, message: Document) -> Document:
        """Send a message and wait for its answer. Raises ClientError where it is refused."""
        if self._reading.done():
            raise ClientError("the run has ended")
        number = next(self._numbers)
        answer = self._answers[number] = asyncio.get_running_loop().create_future()
        self._writer.write(json.dumps({"id": number, **message}).encode() + b"\n")
        await self._writer.drain()
        return _checked(await answer)

    async def events(self) -> AsyncIterator[Document]:
        """Events as they come, until the run ends; the lease is renewed meanwhile."""
        while True:
            try:
                event = await asyncio.wait_for(self._events.get(), self.run["lease_s"] / 3)
            except TimeoutError:
                await self.ask({"type": "ping"})
                continue
            if event is None:
                return
            yield event

    async def _read(self, reader: asyncio.StreamReader) -> None:
        while line := await reader.readline():
            document: Document = json.loads(line)
            if "event" in document:
                self._events.put_nowait(document)
            elif (answer := self._answers.pop(document["answer"], None)) is not None and not answer.done():
                answer.set_result(document)
        self._events.put_nowait(None)
        for answer in self._answers.values():
            if not answer.done():
                answer.set_exception(ClientError("the run has ended"))


def _checked(answer: Document) -> Document:
    if not answer["ok"]:
        raise ClientError(answer["error"])
    return answer
