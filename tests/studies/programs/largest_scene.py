"""Times in the loop for a region that a program sets: alone, and beside the largest scene that programs may hold.

python -m tests.studies.programs.largest_scene --rounds 1000
"""

import time
from typing import Any

import numpy as np

from engine.effects.effect_player import EffectPlayer
from engine.effects.files.conversion import MOST_SEGMENTS
from engine.effects.rules import DEFAULT_EFFECTS, Effect, Rule, Segment, Trigger
from engine.touch import Touch
from tactable.bench.latency.stages import figures_of
from tactable.control.program_scene import MOST_DEFINED, MOST_REGIONS, Scene
from tactable.control.requests import MOST_RULES, Region
from tactable.control.steps import StepDecoder, StepEncoder
from tests.studies.options import read_options

_WIDTH_M = 5e-3  # 32 regions side by side on 160 mm
_FINGERS = (Touch(1, 0.02, 0), Touch(2, 0.1, 1))


class _Loop:
    """A scene with a given number of regions, and the part of it that the loop holds while two fingers touch."""

    def __init__(self, effects: list[Effect], regions: int) -> None:
        self._scene, self._effects = Scene({}), effects
        self._encoder, self._decoder, self._player = StepEncoder(), StepDecoder(), EffectPlayer(DEFAULT_EFFECTS)
        self._player.take_touches(_FINGERS, 0)
        for effect in effects:
            self._scene.define(effect, 1)
        for number in range(regions):
            self.set_region(number)

    def set_region(self, number: int) -> list[int]:
        """Set a region; ns that the loop takes for each part."""
        start_m, names = _WIDTH_M * number, 2 * tuple(Trigger)
        chosen = [self._effects[(number * MOST_RULES + at) % len(self._effects)] for at in range(MOST_RULES)]
        rules = [Rule(on, effect, after_ns=10**8, every_m=_WIDTH_M) for on, effect in zip(names, chosen, strict=True)]
        region = Region(f"r{number}", tuple(rules), None, (start_m, start_m + _WIDTH_M), True, -3.0, False)
        self._scene.set_region(region, 1)
        return [self._take_part(part) for part in self._encoder.parts(self._scene)]

    def _take_part(self, part: bytes) -> int:
        start_ns = time.perf_counter_ns()
        step = self._decoder.decode(part)
        if step is not None:
            self._player.control(step, 0)
        return time.perf_counter_ns() - start_ns


def time_scenes(rounds: int) -> dict[str, Any]:
    """Time a region that is alone and one beside others in turn, each by its dearest part."""
    envelope = tuple(Segment(20_000_000, 20.0 + at % 7) for at in range(MOST_SEGMENTS))
    effects = [Effect(f"e{number}", envelope) for number in range(MOST_DEFINED)]
    alone, beside = _Loop(effects[:MOST_RULES], 1), _Loop(effects, MOST_REGIONS - 1)
    times_ns = [[max(alone.set_region(0)), max(beside.set_region(MOST_REGIONS - 1))] for _ in range(rounds)]
    figures = [figures_of(np.array(column, np.float64)) for column in zip(*times_ns, strict=True)]
    scene = {"effects": MOST_DEFINED, "segments": MOST_SEGMENTS, "regions": MOST_REGIONS}
    ratio = float(np.median([far / near for near, far in times_ns]))
    return {"scene": scene, "alone": figures[0], "beside": figures[1], "ratio_p50": ratio}


if __name__ == "__main__":
    print(time_scenes(read_options(__doc__, rounds=1000).rounds))
