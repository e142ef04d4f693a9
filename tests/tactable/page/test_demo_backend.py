"""The backend of the demo, with its processes: fingers in, pictures out, and what happens when one of them dies."""

import asyncio
import os
import shutil
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from base.child import ChildError
from engine.device import Device
from engine.touch.sources.pointer import Phase, PointerEvent
from firmware_link.emulator.drive_log import DriveEvent
from firmware_link.emulator.synthesis import synthesise
from tactable.page import demo_backend
from tactable.page.choices import Choice, offered
from tactable.page.demo_backend import LONGEST_BACK_OFF_S, SHORTEST_BACK_OFF_S, DemoBackend
from tactable.page.page_messages import Drive, DroppedFile, Kind, Picture, Role
from tactable.page.processes.asynchronous import AsyncChild
from tactable.page.view import View
from tactable.rig.ready import cached_table, early_path
from tactable.shipped import find_device
from tests.precompute.builder.test_table_build import SMALL
from tests.tactable.control.virtual import run_virtual

TICK_S = 1 / 60
# Only against a backend that hangs: the first table of a device is compiled and built meanwhile.
PATIENCE_S = 600
RATE_HZ = 24_000
SHORT = SMALL.replace("279.4 mm", "80 mm")
"""Its early table has clicks at six places."""
FIRST, LAST = PointerEvent(1, 1 / 6, 0.5, Phase.DOWN), PointerEvent(2, 5 / 6, 0.5, Phase.DOWN)


def process_ids(backend: DemoBackend) -> tuple[int, ...]:
    """Process ids of the emulated firmware and the engine, of those that run."""
    return tuple(part.child.process.pid for part in (backend._firmware, backend._engine) if part is not None)


def backend_of(folder: Path, kind: type[DemoBackend] = DemoBackend) -> DemoBackend:
    """A backend of the small bar, none of whose processes runs."""
    (folder / "small.toml").write_text(SMALL, encoding="utf-8")
    name = str(folder / "small.toml")
    return kind(Choice(name), find_device(name), offered(name), folder / "cache", folder)


def test_a_dropped_device_file_is_chosen_and_a_wrong_one_is_told_by_name_place_and_remedy(tmp_path: Path) -> None:
    backend = backend_of(tmp_path)
    before = backend.scene()["choice"]["device"]
    backend.drop(DroppedFile("../my bar.toml", SMALL.replace("279.4 mm", "279.4 kg")))
    trouble = backend.scene()["trouble"]
    assert trouble.startswith("my-bar.toml: bar.length: '279.4 kg'") and "expected a length" in trouble
    assert backend.scene()["choice"]["device"] == before
    backend.drop(DroppedFile("../my bar.toml", SMALL.replace('name = "reference-a"', 'name = "dropped"')))
    scene = backend.scene()
    dropped = Path(scene["choice"]["device"])
    assert (dropped.name, scene["device"]["name"], scene["trouble"]) == ("my-bar.toml", "dropped", "")
    assert dropped.is_relative_to(tmp_path / "dropped") and str(dropped) in scene["devices"]
    backend.choose({"device": before})
    assert backend.scene()["choice"]["device"] == before


def test_a_switch_that_there_is_not_is_told_and_changes_nothing(tmp_path: Path) -> None:
    backend = backend_of(tmp_path)
    before = backend.scene()["choice"]
    for name, wrong in (("level_db", 17), ("device", "../../etc/passwd"), ("nothing", 1), ("quiet_zones", "I")):
        backend.choose({name: wrong})
        assert name in backend.scene()["trouble"] and backend.scene()["choice"] == before
    backend.choose({"level_db": 30})
    assert backend.scene()["trouble"] == "" and backend.scene()["choice"] == {**before, "level_db": 30.0}


def test_actuators_that_are_moved_are_told_with_their_device_file_until_they_are_reset(tmp_path: Path) -> None:
    backend = backend_of(tmp_path)
    file = backend.scene()["device"]["actuators"]
    backend.choose({"actuators_m": [0.075, file[1]["position_m"]]})
    scene = backend.scene()
    assert scene["what_if"]["moved"] == [{"name": "left", "position_m": 0.075, "file_m": file[0]["position_m"]}]
    assert scene["device"]["actuators"][0]["position_m"] == pytest.approx(0.075, abs=1e-9)
    assert Device.parse(scene["what_if"]["text"], "saved").actuators[0].position_m == pytest.approx(0.075, abs=1e-9)
    backend.choose({"actuators_m": []})
    assert backend.scene()["what_if"] is None
    backend.choose({"actuators_m": [0.0, 17.0]})
    assert "actuator[2].position: '17000.00 mm': is off the bar" in backend.scene()["trouble"]
    assert backend.scene()["choice"]["actuators_m"] == []


def test_what_fails_again_and_again_is_started_again_with_growing_pauses_and_told(tmp_path: Path) -> None:
    class Failing(DemoBackend):
        async def _follow(self) -> None:
            tried_s.append(asyncio.get_running_loop().time())
            raise ChildError("the engine was ended by SIGKILL")

    async def run_for_a_minute(backend: DemoBackend) -> None:
        running = asyncio.ensure_future(backend.run())
        await asyncio.sleep(60.0)
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)

    tried_s, backend = list[float](), backend_of(tmp_path, Failing)
    run_virtual(run_for_a_minute(backend))
    pauses_s = [later - sooner for sooner, later in pairwise(tried_s)]
    assert pauses_s[0] == pytest.approx(SHORTEST_BACK_OFF_S) and max(pauses_s) == pytest.approx(LONGEST_BACK_OFF_S)
    assert pauses_s[1:] == pytest.approx([min(2 * before_s, LONGEST_BACK_OFF_S) for before_s in pauses_s[:-1]])
    scene = backend.scene()
    assert (scene["status"], scene["restarts"]) == ("restarting", len(tried_s))
    assert "was ended by SIGKILL" in scene["trouble"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, click_table: Path) -> Path:
    """The description of a small bar, and a cache with its table."""
    folder = tmp_path_factory.mktemp("demo")
    (folder / "small.toml").write_text(SMALL, encoding="utf-8")
    device = find_device(str(folder / "small.toml"))
    (folder / "cache").mkdir()
    shutil.copy(click_table, cached_table(device, folder / "cache"))
    return folder


class Rig:
    """A backend, and the hand of its only browser; time passes only while it waits for something."""

    def __init__(self, backend: DemoBackend, loop: asyncio.AbstractEventLoop) -> None:
        self.backend = backend
        self.told: list[bytes] = []
        self._loop = loop
        self._pressed: dict[int, PointerEvent] = {}

    def press(self, *events: PointerEvent) -> None:
        self._pressed |= {event.pointer_id: event for event in events}
        self.backend.touch(1, events)

    def is_down(self, event: PointerEvent) -> bool:
        return event.pointer_id in self._pressed

    def lift(self, *events: PointerEvent) -> None:
        """These fingers, or all."""
        for event in events or tuple(self._pressed.values()):
            self.backend.touch(1, [replace(event, phase=Phase.UP)])
            del self._pressed[event.pointer_id]

    def wait(self, condition: Callable[[], bool]) -> None:
        """Until it holds; fingers that are down say so again and again."""

        async def wait() -> None:
            end_s = time.monotonic() + PATIENCE_S
            while not condition():
                assert time.monotonic() < end_s, self.backend.scene()
                self.backend.touch(1, [replace(event, phase=Phase.MOVE) for event in self._pressed.values()])
                messages, _ = self.backend.tick()
                self.told += [message for message in messages if message[1] != Kind.PICTURE]
                await asyncio.sleep(TICK_S)

        self._loop.run_until_complete(wait())

    def until(self, condition: Callable[[Picture], bool]) -> Picture:
        """The first picture for which it holds."""
        self.wait(lambda: self.backend.view is not None and condition(self.backend.view.picture()))
        assert self.backend.view is not None
        return self.backend.view.picture()

    def choose(self, **switches: object) -> None:
        """Move switches, and wait until what is chosen plays."""
        self.backend.choose(switches)
        of_the_bar = {"is_loaded": True, "is_other": False}
        self.wait(lambda: self.backend.scene()["plays"] == self.backend.scene()["choice"] | of_the_bar)


@contextmanager
def running(folder: Path, name: str | None = None) -> Iterator[Rig]:
    """A backend that runs whenever its rig does something, and is over at the end; by default of the small bar."""
    name = name or str(folder / "small.toml")
    loop = asyncio.new_event_loop()
    backend = DemoBackend(Choice(name), find_device(name), offered(name), folder / "cache", folder)
    runs = loop.create_task(backend.run())
    try:
        yield Rig(backend, loop)
    finally:
        runs.cancel()
        loop.run_until_complete(asyncio.gather(runs, return_exceptions=True))
        loop.close()


@pytest.mark.machine
def test_the_demo_plays_on_through_runs_and_kernels_and_the_deaths_of_its_processes(folder: Path) -> None:
    with running(folder) as rig:
        # Kernels are compiled first; then a new run begins, for which fingers that are down come at once.
        rig.wait(lambda: bool(rig.backend.scene()["has_kernels"]))
        steps: tuple[Callable[[Rig], None], ...] = (
            switches_change_over_without_a_new_process,
            fingers_that_rest_while_one_run_follows_another_play_in_both,
            a_finger_that_lifts_between_two_runs_rests_in_neither,
            fingers_that_load_nothing_break_the_promise,
            another_bar_is_played_until_it_is_the_tables_again,
            a_drive_goes_on_without_a_jolt_when_kernels_are_adopted,
            partial(a_process_that_dies_is_started_again, which=0),  # the emulated firmware
            partial(a_process_that_dies_is_started_again, which=1),  # the engine
        )
        for step in steps:
            rig.choose(source="click", quiet_zones=[], level_db=20, is_loaded=True, is_other=False, actuators_m=[])
            step(rig)
            rig.lift()
            rig.until(lambda picture: not picture.fingers)


def tap_until(rig: Rig, finger: PointerEvent, condition: Callable[[Picture], bool]) -> Picture:
    """A picture 0.6 s after a finger came down beside another one, for which it holds; it taps until then."""
    while True:
        if not rig.is_down(finger):
            rig.press(finger)
        picture = rig.until(lambda picture: len(picture.fingers) == 2 and picture.command > 0 and picture.age_s > 0.6)
        if condition(picture):
            return picture
        rig.lift(finger)
        rig.until(lambda picture: len(picture.fingers) == 1 and picture.age_s > 1)


def is_clicked(picture: Picture) -> bool:
    return picture.drive is Drive.CLICK and len(picture.made) == 2 and not picture.is_late


def is_kept(picture: Picture) -> bool:
    """Whether every finger has what it was promised; later where the machine stalls, and the firmware falls silent."""
    found = [(made.promised_db, made.simulated_db) for made in picture.made if made.promised_db is not None]
    return all(told is not None and abs(told - promised) < 0.2 for promised, told in found)


def _is_first_felt(picture: Picture) -> bool:
    return [made.role for made in picture.made] == [Role.FELT, Role.QUIET] and len(picture.fingers) == 2


def switches_change_over_without_a_new_process(rig: Rig) -> None:
    processes = process_ids(rig.backend)
    rig.choose(source="steady", quiet_zones=["III"], level_db=10)
    rig.press(FIRST, LAST)
    picture = rig.until(lambda picture: len(picture.made) == 2 and picture.age_s > 1.0 and is_kept(picture))
    assert (picture.drive, picture.wanted_db, picture.is_playing) == (Drive.STEADY, 10.0, True)
    assert [finger.role for finger in picture.fingers] == [Role.FELT, Role.QUIET]
    assert process_ids(rig.backend) == processes


def fingers_that_rest_while_one_run_follows_another_play_in_both(rig: Rig) -> None:
    class SlowView(View):
        """A view that is made while something is compiled, as the first one with kernels is."""

        def __init__(self, *arguments: Any, **options: Any) -> None:
            super().__init__(*arguments, **options)
            time.sleep(0.5)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(demo_backend, "View", SlowView)
        rig.choose(source="steady", quiet_zones=["III"])
        rig.press(FIRST, LAST)
        rig.until(lambda picture: picture.is_playing and picture.wanted_db == 20 and _is_first_felt(picture))
        rig.choose(level_db=10)
        rig.until(lambda picture: picture.is_playing and picture.wanted_db == 10 and _is_first_felt(picture))


def a_finger_that_lifts_between_two_runs_rests_in_neither(rig: Rig) -> None:
    """The last records of the run before, in which it rested, are still unread then."""
    rig.press(FIRST)
    rig.until(lambda picture: len(picture.fingers) == 1)
    rig.backend.choose({"level_db": 10})
    rig.wait(lambda: rig.backend._is_between)
    rig.lift()
    rig.choose(level_db=10)
    ticks = iter(range(5))
    rig.wait(lambda: next(ticks, None) is None)  # the records that are there are read
    rig.until(lambda picture: not picture.fingers)


def fingers_that_load_nothing_break_the_promise(rig: Rig) -> None:
    rig.choose(source="steady")
    rig.press(FIRST)
    loaded = rig.until(lambda picture: picture.command > 0 and picture.age_s > 1.0 and is_kept(picture))
    rig.choose(is_loaded=False)
    freed_s = rig.until(lambda picture: not picture.is_loaded).time_s
    free = rig.until(lambda picture: picture.time_s > freed_s + 1.5)
    assert free.made[0].simulated_db is not None and loaded.made[0].simulated_db is not None
    assert abs(free.made[0].simulated_db - loaded.made[0].simulated_db) > 0.5


def another_bar_is_played_until_it_is_the_tables_again(rig: Rig) -> None:
    found = list[float]()
    for is_other in (False, True, False):
        rig.choose(source="steady", is_other=is_other)
        assert (rig.backend.scene()["other"] is not None) == is_other
        before = rig.until(lambda _: True).command
        rig.press(FIRST)
        shown = rig.until(partial(is_judged_after, before))
        assert shown.made[0].simulated_db is not None
        found.append(shown.made[0].simulated_db)
        rig.lift()
        rig.until(lambda picture: not picture.fingers)
    assert found[2] == pytest.approx(found[0], abs=0.1) and abs(found[1] - found[0]) > 0.1


def is_judged_after(command: int, picture: Picture) -> bool:
    return picture.command > command and picture.age_s > 1.0 and picture.made[0].low_db is not None


def a_drive_goes_on_without_a_jolt_when_kernels_are_adopted(rig: Rig) -> None:
    """One run ends and another begins: the drive fades out and in by the slew of the device."""
    events, builder = list[DriveEvent](), rig.backend._builder

    class HeardView(View):
        def take_events(self, found: Sequence[DriveEvent]) -> None:
            events.extend(found)
            super().take_events(found)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(demo_backend, "View", HeardView)
        rig.choose(source="steady", level_db=10)
        rig.press(FIRST)
        for has_compiled in (False, True):
            rig.until(lambda picture: picture.is_playing and picture.age_s > 0.5)
            builder.has_compiled = has_compiled
            rig.backend.choose({})
            rig.wait(lambda has=has_compiled: rig.backend.scene()["has_kernels"] is has)  # type: ignore[misc]
        last = rig.until(lambda picture: picture.is_playing and picture.age_s > 0.5)
    moved = synthesise(events, events[0].device_time_us, 1e6 * last.time_s, RATE_HZ)
    device = find_device(rig.backend.scene()["choice"]["device"])
    most = max(event.channels[i].amplitude for event in events for i in range(len(device.actuators)))
    top_hz = max(actuator.band_hz[1] for actuator in device.actuators)
    assert abs(moved).max() > 0.5 * most
    assert abs(np.diff(moved, axis=0)).max() * RATE_HZ <= 2 * np.pi * top_hz * most + events[0].slew_per_s
    assert sum(not any(channel.amplitude for channel in event.channels) for event in events) >= 2  # it did fade


def a_process_that_dies_is_started_again(rig: Rig, which: int) -> None:
    before, restarts = process_ids(rig.backend), rig.backend.restarts
    os.kill(before[which], signal.SIGKILL)
    rig.wait(lambda: rig.backend.restarts > restarts)
    assert "was ended by SIGKILL" in rig.backend.scene()["trouble"]
    rig.choose()
    assert not set(before) & set(process_ids(rig.backend))
    rig.press(FIRST)
    rig.until(lambda picture: picture.command > 0 and picture.age_s > 0.1)


@pytest.mark.machine
def test_a_device_without_a_table_plays_steady_drives_at_once_then_clicks_as_they_are_solved(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Until its table is in place, the early one at least. Nothing of the rig is left behind."""
    (tmp_path / "short.toml").write_text(SHORT, encoding="utf-8")
    seen, solved_for = set[str | None](), set[int]()

    def is_clicked_and_solved(picture: Picture) -> bool:
        # Where the machine stalls, fingers lift, and what was solved last may be for the one that came back first.
        solved_for.add(len(own.backend.scene()["solved"]["last_m"]))
        return is_clicked(picture)

    def has_table(backend: DemoBackend) -> bool:
        scene = backend.scene()
        seen.add((scene["building"] or {}).get("step"))
        return bool(scene["clicks"]) and scene["solved"] is None

    with ExitStack() as pause, running(tmp_path, str(tmp_path / "short.toml")) as own:
        pause.enter_context(paused_at_its_first_table(monkeypatch))
        own.wait(lambda: own.backend.scene()["status"] == "running")
        first = own.backend.scene()
        own.press(FIRST)
        steady = own.until(lambda picture: picture.command > 0)
        own.lift()
        own.wait(lambda: own.backend.scene()["solved"] is not None)
        own.press(LAST)
        own.until(lambda picture: len(picture.fingers) == 1)
        clicked = tap_until(own, FIRST, is_clicked_and_solved)
        own.lift()
        pause.close()
        own.wait(lambda: has_table(own.backend))
        processes = process_ids(own.backend)
    assert (first["has_kernels"], first["clicks"], first["choice"]["source"]) == (False, 0, "click")
    assert (steady.drive, steady.is_playing) == (Drive.STEADY, True)
    assert steady.made[0].promised_db is not None  # without a kernel, too
    felt, quiet = clicked.made
    assert (felt.role, quiet.role) == (Role.FELT, Role.QUIET)
    assert felt.simulated_db == pytest.approx(felt.promised_db, abs=0.5)
    assert 2 in solved_for
    assert "clicks" in seen
    assert not list(tmp_path.glob("first-*"))
    path = cached_table(find_device(str(tmp_path / "short.toml")), tmp_path / "cache")
    assert early_path(path).exists() or path.exists()
    assert len(processes) == 2
    for process in processes:
        with pytest.raises(ProcessLookupError):
            os.kill(process, 0)
    assert not list(tmp_path.glob("ring-*"))


@contextmanager
def paused_at_its_first_table(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Builds stand still once they have said that the first table is there, until the context ends."""
    stopped, read = list[int](), AsyncChild.read

    async def read_and_stop(child: AsyncChild) -> dict[str, Any]:
        answer = await read(child)
        if "first-clicks" in str(answer.get("usable")):
            stopped.append(child.process.pid)
            os.kill(child.process.pid, signal.SIGSTOP)
        return answer

    with monkeypatch.context() as patch:
        patch.setattr(AsyncChild, "read", read_and_stop)
        try:
            yield
        finally:
            for process in stopped:
                os.kill(process, signal.SIGCONT)


@pytest.mark.machine
def test_a_shipped_device_plays_clicks_before_anything_is_compiled(tmp_path: Path) -> None:
    with running(tmp_path, "reference-a") as own:
        own.wait(lambda: own.backend.scene()["status"] == "running")
        first = own.backend.scene()
        own.press(replace(FIRST, x=0.1))
        picture = own.until(lambda picture: picture.command > 0 and picture.drive is Drive.CLICK)
    assert (first["is_shipped"], first["has_kernels"], first["clicks"] > 100) == (True, False, True)
    assert picture.made[0].promised_db is not None
