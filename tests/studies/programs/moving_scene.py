"""Changes the scene of a run 1000 times while a finger taps: no report is lost, and no tap gets a wrong effect.

    python -m tests.studies.programs.moving_scene --changes 1000 --seed 1

A program moves one region along the bar, each time with another effect. Taps come 25 times a second, at random places.
A tap that comes down between the sending of a change and its answer may get the old scene or the new one; every other
tap must get the level of the scene in force at its place. The firmware is SIMULATED.
"""

import json
import random
import time
from contextlib import suppress
from itertools import pairwise
from typing import Any, NamedTuple

from engine.effects.rules import Effects
from tactable.control.client import Client, ClientError, connect
from tactable.shipped import named_effects
from tests.studies.options import read_options
from tests.studies.trust.controlled_run import DEVICE, controlled_run
from tests.tactable.rig.strokes import Stroke, make_recording

LEVELS_DB = {name: Effects((), (named_effects()[name],)).levels_db[0] for name in ("press", "tick", "release", "hover")}
ELSEWHERE_DB = 20.0
TAP_S = 0.04
WIDTH = 0.4


class Scene(NamedTuple):
    """One scene: when it was asked for and answered, where its region lies, and the level there."""

    sent_ns: int
    answered_ns: int
    start_m: float
    stop_m: float
    level_db: float

    def level_at(self, at_m: float) -> float:
        """The level that a tap gets."""
        return self.level_db if self.start_m <= at_m <= self.stop_m else ELSEWHERE_DB


def change(client: Client, changes: int, pause_s: float, random_: random.Random) -> list[Scene]:
    """Move the region so many times; the scenes in order, the first without a region."""
    length_m = DEVICE.bar.length_m
    scenes = [Scene(0, 0, -1.0, -1.0, 0.0)]
    for _ in range(changes):
        start_m, effect = random_.random() * (1 - WIDTH) * length_m, random_.choice(list(LEVELS_DB))
        sent_ns = time.monotonic_ns()
        client.set_region("key", [start_m, start_m + WIDTH * length_m], touch=effect)
        stop_m = start_m + WIDTH * length_m
        scenes.append(Scene(sent_ns, time.monotonic_ns(), start_m, stop_m, LEVELS_DB[effect]))
        time.sleep(pause_s)
    return scenes


def until_the_end(listener: Client) -> list[dict[str, Any]]:
    """All events, until the recording is over and with it the run."""
    events: list[dict[str, Any]] = []
    with suppress(ClientError):
        for event in listener.events():
            events.append(event)  # noqa: PERF402  # what came before the run ended is kept
    return events


def judge(scenes: list[Scene], felt: list[tuple[int, float, float]]) -> dict[str, int]:
    """Count the taps (time_ns, place, level) by whether the level is that of a scene in force."""
    counts = {"right": 0, "right, during a change": 0, "wrong": 0}
    bounded = [*pairwise(scenes), (scenes[-1], None)]
    for time_ns, at_m, level_db in felt:
        allowed = {
            scene.level_at(at_m)
            for scene, after in bounded
            if scene.sent_ns <= time_ns and (after is None or time_ns <= after.answered_ns)
        }
        during = any(scene.sent_ns <= time_ns <= scene.answered_ns for scene in scenes)
        key = "wrong" if level_db not in allowed else "right, during a change" if during else "right"
        counts[key] += 1
    return counts


def run(changes: int, seed: int, pause_s: float = 0.01) -> dict[str, object]:
    """Change the scene of a run of its own; what the taps got."""
    random_ = random.Random(seed)
    taps = round(changes * pause_s * 1.6 / TAP_S) + 100
    places = [0.02 + 0.96 * random_.random() for _ in range(taps)]
    strokes = tuple(Stroke(TAP_S * n, TAP_S * n + TAP_S / 2, at, at) for n, at in enumerate(places))
    recording = make_recording(strokes)
    with (
        controlled_run(recording) as process,
        connect(process.socket, lease_s=60.0) as listener,
        connect(process.socket, lease_s=60.0) as client,
    ):
        listener.subscribe("played")
        scenes = change(client, changes, pause_s, random_)
        events = until_the_end(listener)
        summary = process.summary()
    felt = list[tuple[int, float, float]]()
    for event in events:
        if event["event"] == "played" and event["kind"] != "silence":
            (at_m,) = [each["at_m"] for each in event["fingers"] if each["role"] == "felt"]
            felt.append((event["time_ns"], at_m, event["level_db"]))
    longest_ms = max(scene.answered_ns - scene.sent_ns for scene in scenes) / 1e6
    return {
        "seed": seed,
        "changes": changes,
        "taps_heard": len(felt),
        **judge(scenes, felt),
        "longest_answer_ms": round(longest_ms, 2),
        "events_lost": sum(event["count"] for event in events if event["event"] == "lost"),
        "reports_of_the_recording": len(recording.reports),
        "reports": summary["reports"],
        "lost_frames": summary["digitizer"]["lost_frames"],
        "mispredicted": summary["commands_mispredicted"],
        "control_steps": summary["control_steps"],
    }


def main() -> None:
    """Read the options, run, and print the counts."""
    asked = read_options(__doc__, changes=1000, seed=1)
    print(json.dumps(run(asked.changes, asked.seed), indent=2))


if __name__ == "__main__":
    main()
