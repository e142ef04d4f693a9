"""Conducts a session: trial by trial the stage plays, the page asks, and the answer is written before the next."""

import asyncio
import contextlib
import json
import math
import socket
from collections.abc import Callable, Coroutine, Mapping
from pathlib import Path
from typing import Any, TypeVar

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from tactable.control.client import ClientError
from tactable.control.security import AccessPolicy, quiet_server
from tactable.experiment.protocol import ExperimentError
from tactable.experiment.session import Role, Session, Trial
from tactable.experiment.stage import LiveStage
from tactable.experiment.trial_files import SessionFiles, row_of
from tactable.page.page_server import answer_file, files_of

MOST_BYTES = 1024
MOST_BROWSERS = 8
_STATIC = Path(__file__).parent / "static"
_ICON = Path(__file__).parents[1] / "page" / "static" / "icon.svg"
_FEEDBACK_S = 1.2
_MOST_SPOILED = 20  # in a row: then something is wrong that another try does not mend
Result = TypeVar("Result")
Mark = Callable[[str], None]


def no_marks(_text: str) -> None:
    """Marks where no stream was asked for."""


def open_stream(name: str, participant: str) -> Mark:
    """Open a stream of texts, for recordings of brain or body beside an experiment; what sends one.

    Raises ExperimentError where pylsl or its library is absent.
    """
    try:
        from pylsl import StreamInfo, StreamOutlet
    except (ImportError, RuntimeError) as error:
        raise ExperimentError(
            f"markers = 'lsl': pylsl cannot be used here ({error}): pip install 'tactable[lsl]'"
        ) from None
    outlet = StreamOutlet(StreamInfo(name, "Markers", 1, 0, "string", f"tactable-{name}-{participant}"))
    return lambda text: outlet.push_sample([text])


class Screen:
    """What the page shows, and what is answered there; every page that is open shows the same.

    `state` is JSON: its kind, text, choices and progress, and a number, which an answer repeats. It never has a level.
    """

    def __init__(self, on_change: Callable[[], None] = lambda: None) -> None:
        self.state: dict[str, Any] = {"number": 0, "kind": "wait", "text": "", "choices": [], "done": 0.0, "lit": None}
        self.stopped = asyncio.Event()
        self.on_change = on_change
        self._answer: asyncio.Future[tuple[int, float]] | None = None

    def show(self, kind: str, text: str, choices: tuple[str, ...] = (), **more: Any) -> None:
        """Show something in place of what was shown."""
        number = self.state["number"] + 1
        more = {"lit": None, "intervals": 0, "done": self.state["done"], **more}
        self.state = {"number": number, "kind": kind, "text": text, "choices": list(choices), **more}
        self.on_change()

    async def ask(self, kind: str, text: str, choices: tuple[str, ...], **more: Any) -> tuple[int, float]:
        """Show a question; the index of the choice, and after how many milliseconds by the page's clock."""
        self._answer = asyncio.get_running_loop().create_future()
        self.show(kind, text, choices, **more)
        try:
            return await self._answer
        finally:
            self._answer = None

    def receive(self, message: Mapping[str, Any]) -> None:
        """Take what a page says. What is no answer to the present question, or comes twice, is passed over."""
        if message.get("stop") is True:
            self.stopped.set()
            return
        choice: Any = message.get("choice")
        after_ms: Any = message.get("after_ms")
        if self._answer is None or self._answer.done() or message.get("number") != self.state["number"]:
            return
        is_choice = type(choice) is int and 0 <= choice < len(self.state["choices"])
        if is_choice and type(after_ms) in (int, float) and 0 <= after_ms < math.inf:
            self._answer.set_result((choice, float(after_ms)))


async def conduct(
    session: Session, stage: LiveStage, screen: Screen, files: SessionFiles, consent: str, mark: Mark = no_marks
) -> None:
    """Ask all trials that are left. Raises ClientError when the run ends or refuses; what was answered is kept."""
    clock, spoiled, task_shown = asyncio.get_running_loop(), 0, ""
    started_s = clock.time()
    screen.state["done"] = session.done / session.total
    await screen.ask("consent", consent, ("I agree, and begin",))
    while (trial := session.next_trial()) is not None:
        if trial.task.name != task_shown:
            await screen.ask("introduction", introduction(trial), ("Start",))
            task_shown = trial.task.name
        mark(f"trial {trial.number + 1} task {trial.task.name} role {trial.role}")
        onset_s = clock.time() - started_s
        asked = await _unless_stopped(_one_trial(trial, stage, screen, mark), stage, screen)
        if asked is None:
            spoiled += 1
            if spoiled > _MOST_SPOILED:
                raise ClientError(
                    f"{spoiled} trials in a row were not played as asked: see that the fingers rest on their places "
                    "and that the table is the one that the run plays; then start this command again"
                )
            continue
        spoiled, (columns, answer, after_ms) = 0, asked
        is_right = session.record(trial, answer)
        timed = {**columns, "response_ms": round(after_ms, 1), "onset_s": round(onset_s, 3)}
        files.append(row_of(trial, answer, is_right, timed))
        mark(f"answer {trial.number + 1} {trial.task.choices[answer]}")
        screen.state["done"] = session.done / session.total
        if trial.role is Role.PRACTICE:
            right = trial.task.choices[trial.side]
            screen.show("feedback", "Right." if is_right else f"It was: {right}.")
            await asyncio.sleep(_FEEDBACK_S)
    screen.show("done", "That was all. Thank you.")


def introduction(trial: Trial) -> str:
    """What the page says before a task."""
    task, many = trial.task, len(trial.task.position_m) > 1
    intervals = "Two moments follow each other, marked 1 and 2. " if task.kind.has_intervals else ""
    question = task.question.format(finger="the finger that is named" if many else "your finger")
    about = f"{intervals}{question} If you are not sure, guess."
    practice = f" The first {task.practice} are for practice." if task.practice else ""
    return f"Rest {'your fingers' if many else 'one finger'} at {task.places_text}. {about}{practice}"


async def _one_trial(
    trial: Trial, stage: LiveStage, screen: Screen, mark: Mark
) -> tuple[dict[str, Any], int, float] | None:
    """Play and ask; the columns of what was played, the answer, and its time. None: it was not played as asked."""
    task = trial.task
    missing = (
        f"Rest {'one finger' if len(task.position_m) == 1 else 'your fingers'} at {task.places_text}, and nothing else."
    )
    await stage.wait_for_fingers(task, lambda: screen.show("fingers", missing))

    def on_interval(number: int | None) -> None:
        intervals = 2 if task.kind.has_intervals else 1
        screen.show("interval", "Feel.", lit=number, intervals=intervals)
        if number is not None:
            mark(f"interval {trial.number + 1} {number + 1}")

    try:
        columns = await stage.play(trial, on_interval)
    except ClientError:
        return None
    if columns is None:
        return None
    question = task.question.format(finger=task.finger_name(trial.finger))
    return columns, *await screen.ask("question", question, task.choices)


async def _unless_stopped(work: Coroutine[Any, Any, Result], stage: LiveStage, screen: Screen) -> Result | None:
    """Do the work; None where the stop button ended it, once the participant goes on."""
    screen.stopped.clear()
    working, stopping = asyncio.ensure_future(work), asyncio.ensure_future(screen.stopped.wait())
    try:
        await asyncio.wait({working, stopping}, return_when=asyncio.FIRST_COMPLETED)
        if not screen.stopped.is_set():
            return working.result()
        working.cancel()
        await asyncio.wait({working})
        await stage.enable(is_enabled=False)
        await screen.ask("stopped", "Stopped: nothing plays. Go on only if you like.", ("Go on",))
        await stage.enable(is_enabled=True)
        return None
    finally:
        working.cancel()
        stopping.cancel()


class QuestionServer:
    """Serves one screen under one access policy. A browser that connects again sees the present state at once."""

    def __init__(self, screen: Screen, access: AccessPolicy) -> None:
        self._screen, self._access = screen, access
        self._browsers: dict[WebSocket, asyncio.Event] = {}
        self._files = files_of((*_STATIC.iterdir(), _ICON))
        screen.on_change = self._tell
        files = [Route("/{token}/", self._answer_file), Route("/{token}/{name}", self._answer_file)]
        self.app = Starlette(routes=[WebSocketRoute("/{token}/answers", self._converse), *files])
        self.app.router.redirect_slashes = False

    async def _answer_file(self, request: Request) -> Response:
        return await answer_file(request, self._access, self._files, "question.html")

    async def _converse(self, socket_: WebSocket) -> None:
        if not self._access.admits(socket_, is_own_page=True) or len(self._browsers) >= MOST_BROWSERS:
            await socket_.close()
            return
        await socket_.accept()
        self._browsers[socket_] = news = asyncio.Event()
        news.set()
        sending = asyncio.create_task(self._send(socket_, news))
        try:
            while True:
                with contextlib.suppress(ValueError, RecursionError):  # what is no JSON is no answer
                    message = json.loads(await socket_.receive_text())
                    if isinstance(message, dict):
                        self._screen.receive(message)
        except (WebSocketDisconnect, KeyError, RuntimeError):  # gone, or bytes in place of text
            pass
        finally:
            del self._browsers[socket_]
            sending.cancel()

    async def _send(self, socket_: WebSocket, news: asyncio.Event) -> None:
        """Send the newest state as fast as the browser takes it; states between are left out."""
        with contextlib.suppress(WebSocketDisconnect, RuntimeError):
            while True:
                await news.wait()
                news.clear()
                await socket_.send_text(json.dumps(self._screen.state))

    def _tell(self) -> None:
        for news in self._browsers.values():
            news.set()


async def serve_questions(
    screen: Screen, listening: socket.socket, access: AccessPolicy, work: Coroutine[Any, Any, None]
) -> None:
    """Serve the page while `work` goes on, and a moment longer, so that its last word is shown; raises as `work`."""
    server = quiet_server(QuestionServer(screen, access).app, MOST_BYTES)
    serving, working = asyncio.create_task(server.serve(sockets=[listening])), asyncio.create_task(work)
    await asyncio.wait({serving, working}, return_when=asyncio.FIRST_COMPLETED)
    if not working.done():  # a signal ended the server
        working.cancel()
    await asyncio.sleep(0.2)
    server.should_exit = True
    await serving
    with contextlib.suppress(asyncio.CancelledError):
        await working
