"""What trials play: predicted from a table, and played by a live or simulated engine through its control channel."""

import asyncio
import contextlib
import math
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from base.files import work_folder
from base.points import parts_of, point_of_json, point_text
from engine.table import Table
from engine.touch.sources.pointer import Phase, PointerEvent, PointerFeed
from tactable.control.client import AsyncClient
from tactable.experiment.protocol import ExperimentError, Kind, Protocol, Task
from tactable.experiment.session import Role, Stimulus, Trial, stimuli_of
from tactable.page.choices import Choice
from tactable.page.processes.asynchronous import EngineProcess, FirmwareProcess
from tactable.page.processes.engine_process import Order, ProgramsAt
from tactable.rig.emulate import configuration_of

NEAR_M = 5e-3  # a finger that rests within this distance of its place is on it; clicks are made for places 3 mm apart
_SETTLE_S = 0.5  # fingers rest for this long before a trial, so that nothing of their touch is felt in it
_BEFORE_S, _AFTER_S, _APART_S = 0.3, 0.5, 0.4  # of the stimulus in its interval; between two intervals
_SAME_HZ = 0.02  # tones that differ by less, relative, have one threshold
_LATE_S = 0.3  # what was written is told within some milliseconds; later it is not of this trial
_MENTIONED_S = 0.2  # a pointer that is not mentioned for a second is released
_EFFECT = "experiment-"


@dataclass(frozen=True)
class Prediction:
    """What a table predicts of one stimulus. peak_m_per_s2: under the finger that feels; the rest as in the columns."""

    is_achieved: bool
    felt_low_db: float
    felt_db: float
    quiet_db: float | None
    quiet_high_db: float | None
    frequency_hz: float | None
    peak_m_per_s2: float


def predict(table: Table, task: Task, stimulus: Stimulus) -> Prediction:
    """The click or drive of a table for a stimulus. Raises ExperimentError where the table has none."""
    placement, device = task.placement(stimulus.finger), table.device
    if task.stimulus == "click":
        click = table.click_at(placement, stimulus.level_db)
        if click is None:
            raise ExperimentError(
                f"task {task.name}: {table.path} has no click for fingers at {task.places_text}: build it with "
                f"--clicks-up-to {len(task.position_m)}, or ask for stimulus = 'tone'"
            )
        levels_db = [each.level_db for each in click.fingers]
        quiet = click.quiet
        return Prediction(
            click.achieved,
            click.felt.low_db,
            levels_db[stimulus.finger],
            None if quiet is None else levels_db[1 - stimulus.finger],
            None if quiet is None else quiet.high_db,
            None,
            click.fingers[stimulus.finger].acceleration_at_finger_m_per_s2,
        )
    drive = table.drive_for(
        [task.position_m[stimulus.finger]],
        [at_m for finger, at_m in enumerate(task.position_m) if finger != stimulus.finger],
        stimulus.level_db,
    )
    sampled, other = drive.sampled_level_db, 1 - stimulus.finger
    has_other = len(task.position_m) > 1
    felt_db = float(drive.level_db[stimulus.finger])
    threshold = float(device.threshold.peak_m_per_s2(np.array([drive.frequency_hz]))[0])
    return Prediction(
        drive.achieved,
        float(np.percentile(sampled[:, stimulus.finger], 5)),
        felt_db,
        float(drive.level_db[other]) if has_other else None,
        float(np.percentile(sampled[:, other], 95)) if has_other else None,
        drive.frequency_hz,
        threshold * 10 ** (felt_db / 20),
    )


def strongest(table: Table, protocol: Protocol) -> list[tuple[Task, Stimulus, Prediction]]:
    """The strongest stimulus of each task at each finger.

    Raises ExperimentError where the device does not reach it, and for tones whose frequency changes with their level.
    """
    found = []
    for task in protocol.tasks:
        most_db = max(task.levels_db, default=0.0)
        for finger in range(len(task.position_m)):
            trial = Trial(0, task, Role.TEST, finger, 0, most_db if task.levels_db else task.base_db)
            for stimulus in (each for interval in stimuli_of(trial) for each in interval):
                predicted = predict(table, task, stimulus)
                if not predicted.is_achieved:
                    reach = predict(table, task, stimulus._replace(level_db=math.inf)).felt_low_db
                    place = point_text(task.position_m[stimulus.finger])
                    raise ExperimentError(
                        f"task {task.name}: {stimulus.level_db:g} dB at {place}: "
                        f"the device {table.device.name} reaches {math.floor(reach)} dB there; lower `levels` or "
                        "`base`, or choose other places"
                    )
                found.append((task, stimulus, predicted))
                weakest = predict(table, task, stimulus._replace(level_db=min(task.levels_db, default=most_db)))
                low_hz, high_hz = sorted((weakest.frequency_hz or 0.0, predicted.frequency_hz or 0.0))
                if task.kind is Kind.DETECTION and high_hz > low_hz * (1 + _SAME_HZ):
                    raise ExperimentError(
                        f"task {task.name}: its strongest tone is of {predicted.frequency_hz:.0f} Hz, its weakest of "
                        f"{weakest.frequency_hz:.0f} Hz, so it has no one threshold; lower the highest of `levels`"
                    )
    return found


class LiveStage:
    """Plays trials on a run whose control channel a client is connected to. `required` is told which fingers rest."""

    def __init__(self, client: AsyncClient, required: Callable[[Sequence[complex]], None] = lambda _: None) -> None:
        self._client, self._required = client, required
        self._played: list[dict[str, Any]] = []
        self._fingers: list[dict[str, Any]] = []
        self._news = asyncio.Event()
        self._reading = asyncio.create_task(self._read())

    @classmethod
    async def on(
        cls,
        client: AsyncClient,
        protocol: Protocol,
        device_name: str,
        required: Callable[[Sequence[complex]], None] = lambda _: None,
    ) -> "LiveStage":
        """Set a run up: nothing but what the experiment plays is felt. Raises ExperimentError for another device."""
        if client.run["device"] != device_name:
            raise ExperimentError(
                f"the run plays {client.run['device']}, and the table is of {device_name}: give the table that it plays"
            )
        stage = cls(client, required)
        await stage.enable(is_enabled=True)
        for duration_s in {task.duration_s for task in protocol.tasks}:
            length = f"{1e3 * duration_s:g} ms" if duration_s else "click"
            await client.ask({"type": "define", "name": _name_of(duration_s), "envelope": [[length, "0 dB"]]})
        answer = await client.ask({"type": "subscribe", "to": ["touches", "played"]})
        stage._fingers = answer["fingers"]
        return stage

    async def close(self) -> None:
        """Stop listening."""
        self._reading.cancel()

    async def enable(self, *, is_enabled: bool) -> None:
        """Let everything be felt, or nothing: what plays ends at once."""
        await self._client.ask({"type": "settings", "enabled": is_enabled, "rule_file": False, "level_change": "0 dB"})

    async def wait_for_fingers(self, task: Task, on_missing: Callable[[], None]) -> None:
        """Until exactly the task's fingers have rested on their places for a moment. Raises what the run raises."""
        self._required(task.position_m)
        is_told = False
        while True:
            self._check()
            if self._contacts(task) is None:
                if not is_told:
                    on_missing()
                is_told = True
                self._news.clear()
                await self._news.wait()
                continue
            await asyncio.sleep(_SETTLE_S)
            if self._contacts(task) is not None:
                return

    async def play(self, trial: Trial, on_interval: Callable[[int | None], None]) -> dict[str, Any] | None:
        """Play a trial; what was written for the stimulus that is asked about, by column.

        None: something else was played than was asked for, since a finger moved or the machine stalled. Raises
        ClientError where the run refuses, as of a finger that has left.
        """
        found: dict[str, Any] = {}
        for number, stimuli in enumerate(stimuli_of(trial)):
            if number:
                on_interval(None)
                await asyncio.sleep(_APART_S)
            on_interval(number)
            await asyncio.sleep(_BEFORE_S)
            started_s, before_ns = asyncio.get_running_loop().time(), None
            for stimulus in stimuli:
                await asyncio.sleep(max(0.0, started_s + stimulus.after_s - asyncio.get_running_loop().time()))
                event = await self._trigger(trial.task, stimulus)
                if event is None:
                    return None
                if number == trial.side or not trial.task.kind.has_intervals:
                    found = _columns(event, before_ns)
                before_ns = event["time_ns"]
            await asyncio.sleep(_AFTER_S + trial.task.duration_s)
        on_interval(None)
        return found if self._contacts(trial.task) is not None else None

    async def _trigger(self, task: Task, stimulus: Stimulus) -> dict[str, Any] | None:
        """Play one stimulus; its event, None where it is not what was asked for."""
        contacts = self._contacts(task)
        if contacts is None:
            return None
        self._played.clear()
        await self._client.ask(
            {
                "type": "trigger",
                "effect": _name_of(task.duration_s),
                "finger": contacts[stimulus.finger],
                "level_change": f"{stimulus.level_db:g} dB",
            }
        )
        late_s = asyncio.get_running_loop().time() + _LATE_S
        while not self._played:
            self._news.clear()
            try:
                async with asyncio.timeout_at(late_s):
                    await self._news.wait()
            except TimeoutError:
                return None
            self._check()
        event = self._played[0]
        felt = [each["finger"] for each in event["fingers"] if each["role"] == "felt"]
        is_asked = event["kind"] == ("click" if task.stimulus == "click" else "drive")
        is_whole = felt == [contacts[stimulus.finger]] and len(event["fingers"]) == len(contacts)
        promise = event["promise"]
        is_achieved = promise is None or promise["is_achieved"]
        return event if is_asked and is_whole and is_achieved else None

    def _contacts(self, task: Task) -> list[int] | None:
        """The contact on each place; None unless each has one and nothing else touches."""
        if len(self._fingers) != len(task.position_m):
            return None
        found = []
        for at_m in task.position_m:
            near = [each for each in self._fingers if abs(point_of_json(each["at_m"]) - at_m) <= NEAR_M]
            if len(near) != 1:
                return None
            found.append(near[0]["finger"])
        return found

    def _check(self) -> None:
        if self._reading.done():
            self._reading.result()
            raise ExperimentError("the run has ended: start it again, then this command, which goes on where it was")

    async def _read(self) -> None:
        try:
            async for event in self._client.events():
                if event["event"] == "touches":
                    self._fingers = event["fingers"]
                elif event["event"] == "played" and event["kind"] != "silence":
                    self._played.append(event)
                self._news.set()
        finally:
            self._news.set()


def _name_of(duration_s: float) -> str:
    return f"{_EFFECT}{1e3 * duration_s:g}"


def _columns(event: dict[str, Any], before_ns: int | None) -> dict[str, Any]:
    promise = event["promise"] or {}
    felt, quiet = promise.get("felt_db") or {}, promise.get("quiet_db") or {}
    return {
        "played": event["kind"],
        "frequency_hz": (event["frequencies_hz"] or [None])[0],
        "felt_low_db": felt.get("5 %"),
        "felt_db": felt.get("nominal"),
        "quiet_db": quiet.get("nominal"),
        "quiet_high_db": quiet.get("95 %"),
        "gap_ms": None if before_ns is None else (event["time_ns"] - before_ns) / 1e6,
    }


def predicted_columns(table: Table, trial: Trial) -> dict[str, Any]:
    """What would be written for the stimulus that a trial asks about, by column. SIMULATED."""
    asked = stimuli_of(trial)[trial.side if trial.task.kind.has_intervals else 0]
    if not asked:
        return {}
    found = predict(table, trial.task, asked[-1])
    names = ("frequency_hz", "felt_low_db", "felt_db", "quiet_db", "quiet_high_db")
    gap_ms = 1e3 * trial.task.gap_s if trial.task.kind is Kind.MASKED and trial.level_db is not None else None
    kind = "click" if trial.task.stimulus == "click" else "drive"
    return {"played": kind, **{name: getattr(found, name) for name in names}, "gap_ms": gap_ms}


class RestingFingers:
    """Fingers on the simulated surface; `rest` says where, and lifts those that rested elsewhere."""

    def __init__(self, feed: PointerFeed, corner_m: complex) -> None:
        self._feed, self._sides_m = feed, parts_of(corner_m)
        self._fingers: dict[int, tuple[float, ...]] = {}
        self._numbers = 0

    def rest(self, position_m: Sequence[complex]) -> None:
        """Rest at these points from now on."""
        places = [
            (*(part / side for part, side in zip(parts_of(at_m), self._sides_m, strict=True)), 0.5)[:2]
            for at_m in position_m
        ]
        if list(self._fingers.values()) == places:
            return
        self._send(Phase.UP)
        numbers = range(self._numbers, self._numbers + len(places))
        self._numbers = (self._numbers + len(places)) % 8  # of at most ten; two at a time
        self._fingers = dict(zip(numbers, places, strict=True))
        self._send(Phase.DOWN)

    async def stay(self, firmware: FirmwareProcess) -> None:
        """Mention the fingers now and then, until cancelled; take what the firmware did, so that it keeps no log."""
        while True:
            firmware.take_answers()
            await asyncio.sleep(_MENTIONED_S)
            self._send(Phase.MOVE)

    def _send(self, phase: Phase) -> None:
        if self._fingers:
            self._feed.send(*(PointerEvent(number, at[0], at[1], phase) for number, at in self._fingers.items()))


@asynccontextmanager
async def simulated_run(table: Table, socket: Path) -> AsyncIterator[Callable[[Sequence[complex]], None]]:
    """Run a table without hardware, its control channel at `socket`; yields what fingers are asked to rest by."""
    with work_folder("experiment", in_memory=True) as folder:
        firmware = await FirmwareProcess.start(configuration_of(table.device))
        engine = await EngineProcess.start(folder / "ring", ProgramsAt(str(socket)))
        fingers = RestingFingers(engine.feed, table.device.surface.corner_m)
        staying = asyncio.create_task(fingers.stay(firmware))
        try:
            choice = Choice(table.device.name)
            await engine.play(Order(table.path, firmware.port, choice, None, has_kernels=True, is_first=False))
            yield fingers.rest
        finally:
            staying.cancel()
            await asyncio.gather(staying, return_exceptions=True)
            with contextlib.suppress(OSError):
                await engine.end()
            await firmware.end()
