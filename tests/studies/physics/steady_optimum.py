"""How far steady drives at positions stay below what a patient search finds, where full scale binds. SIMULATED.

`python -m tests.studies.physics.steady_optimum [DEVICE ...] [--placements N] [--seed N]`: one to five fingers at
random, at least 20 mm apart, some of them felt, at 0.5 to 20 dB below the loudest drive for them. The patient search
climbs at every frequency of the grid from 6 starts, at the 24 best of them from 64 more, and refines the best six peaks
as the solver does. Devices are shipped ones, or `random-SEED-ACTUATORS` (tests/precompute/devices.py).
"""

import argparse
from collections.abc import Iterator
from time import process_time
from typing import Any
from unittest.mock import patch

import numpy as np
from numba import njit

from base.arrays import Integers
from engine.device import Device
from engine.steady import drive_search, steady_solver
from engine.steady.ascent import SHARPEST, climb
from engine.steady.forms import fill_products, loudness_of, ratio_of
from engine.steady.optimum import find_loudest
from engine.steady.steady_drive import SteadyDrive
from engine.steady.steady_solver import SteadySolver
from precompute.predict.at_positions import SteadyDesigner
from tactable.shipped import find_device
from tests.precompute.devices import random_device

BELOW_DB = (0.5, 2.0, 5.0, 10.0, 20.0)
APART_M = 0.02
DEVICES = (
    "reference-a",
    "reference-t",
    "random-20230247606-3",
    "random-7-3",
    "random-3-4",
    "random-5-6",
    "reference-p",
)
_REFINED, _SOME, _MANY, _BEST = 6, 6, 64, 24


def device_of(name: str) -> Device:
    """A shipped device, or a random bar by its seed and number of actuators."""
    kind, *numbers = name.split("-")
    return random_device(*map(int, numbers)) if kind == "random" else find_device(name)


class Asked:
    """What the solver asked its search for a placement, and what that answered; a solve at a level asks once."""

    def __init__(self, solver: SteadySolver) -> None:
        self._solver, self.arguments = solver, tuple[Any, ...]()

    def solve(self, positions_m: list[complex], felt: list[bool], level_db: float) -> SteadyDrive:
        """As the solver's; `arguments` are those of its first search."""
        asked = list[tuple[Any, ...]]()

        def find_drive(*arguments: Any) -> None:
            asked.append(tuple(each.copy() if isinstance(each, np.ndarray) else each for each in arguments[:10]))
            drive_search.find_drive(*arguments)

        with patch.object(steady_solver, "find_drive", find_drive):
            drive = self._solver.solve(positions_m, felt, level_db)
        self.arguments = asked[0]
        return drive

    def best_ratio(self, seed: int) -> float:
        """The greatest ratio that the patient search finds for what was asked last; 0 where no drive is loud."""
        hz, usable, loaded, order, felt, given, is_share, between, wanted, _held = self.arguments
        numerators = 1 if is_share else felt
        ratio, drive = np.zeros(len(hz)), np.zeros(usable.shape, dtype=np.complex128)

        def search(lines: Integers, starts: int, seed: int) -> None:
            found, of_lines = ratio[lines], drive[lines]
            part = usable[lines], np.ascontiguousarray(loaded[..., lines]), order, felt, given[lines]
            _search(*part, numerators, wanted, starts, seed, found, of_lines)
            ratio[lines], drive[lines] = found, of_lines

        search(np.arange(len(hz)), _SOME, seed)
        search(np.argsort(-ratio)[:_BEST], _MANY, seed + 1)
        best = float(ratio.max())
        for k in np.argsort(-ratio)[:_REFINED].tolist():
            if ratio[k] > 0:
                refined, a = np.array([hz[k], ratio[k]]), drive[k].copy()
                parts = usable, loaded, order, felt, given, numerators, is_share, between, wanted, k, refined, a
                drive_search._refine(hz, *parts)
                best = max(best, float(refined[1]))
        return best


@njit
def _search(usable, loaded, order, felt, given, numerators, wanted, starts, seed, ratio, drive):  # type: ignore[no-untyped-def]  # numba
    """Raise ratio (frequency,) and drive (frequency, actuator) where a climb from a random start ends higher."""
    count, m = drive.shape
    last = given.shape[1]
    forms, p, one = np.empty((last + felt, m * m)), np.empty((felt, m), dtype=np.complex128), np.ones(1)
    products, a, loud = np.empty(m * m), np.empty(m, dtype=np.complex128), np.empty(m, dtype=np.complex128)
    np.random.seed(seed)
    for k in range(count):
        drive_search._fill_forms(k, one, loaded, order, felt, given, True, usable[k], forms, p)
        if not usable[k].any() or (find_loudest(p, usable[k], loud) < wanted and felt == 1):
            continue
        for start in range(starts):
            own = 0.0 if start == 0 else np.random.rand() if start % 2 else 1.0
            for i in range(m):
                noise = complex(np.random.normal(), np.random.normal())
                a[i] = (1 - own) * loud[i] + own * noise if usable[k, i] else 0j
            climb(a, usable[k], forms, numerators, last - numerators, np.log(wanted * 1.0001), 3.0, SHARPEST)
            fill_products(a, products)
            if loudness_of(forms, last, m, products) >= wanted:
                found = ratio_of(forms, numerators, last - numerators, products)
                if found > ratio[k]:
                    ratio[k] = found
                    drive[k] = a


def gaps_db(device: Device, placements: int, seed: int) -> Iterator[tuple[int, int, float, float]]:
    """Fingers, felt ones, dB that a drive stays below the patient search, and its processor time in s.

    Placements where neither finds a drive that is loud enough are left out.
    """
    solver, random = SteadyDesigner(device).solver, np.random.default_rng(seed)
    asked, corner_m = Asked(solver), device.surface.corner_m
    for number in range(placements):
        fingers = int(random.integers(1, 6))
        felt = [finger < max(1, int(random.integers(fingers))) for finger in range(fingers)]
        at_m = _apart(random, corner_m, fingers)
        loudest_db = solver.solve(at_m, felt, np.inf).weakest_felt_db
        level_db = loudest_db - float(random.choice(BELOW_DB))
        drive = asked.solve(at_m, felt, level_db)
        begin_s = process_time()
        solver.solve(at_m, felt, level_db)
        spent_s, best = process_time() - begin_s, asked.best_ratio(seed + number)
        own = {"localized factor": drive.value, "contrast": 10 ** (drive.value / 10)}.get(drive.objective, 0.0)
        if max(best, own) > 0:
            yield fingers, sum(felt), float(10 * np.log10(max(best, 1e-30) / max(own, 1e-30))), spent_s


def _apart(random: np.random.Generator, corner_m: complex, fingers: int) -> list[complex]:
    """Random points of the surface, each at least APART_M from the others."""
    while True:
        at_m: list[complex] = (random.random(fingers) * corner_m.real).tolist()
        if isinstance(corner_m, complex):
            at_m = [x + 1j * random.random() * corner_m.imag for x in at_m]
        if all(abs(a - b) >= APART_M for number, a in enumerate(at_m) for b in at_m[:number]):
            return at_m


def main() -> None:
    """Print a row for each device."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("device", nargs="*", default=DEVICES)
    parser.add_argument("--placements", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    for name in options.device:
        rows = np.array(list(gaps_db(device_of(name), options.placements, options.seed)))
        gap_db, alone = rows[:, 2], rows[:, 1] == 1
        print(
            f"{name}: {len(rows)} placements, {100 * np.mean(gap_db <= 0.1):.1f} % within 0.1 dB, worst "
            f"{gap_db.max():.2f} dB; processor time (median) {1e3 * np.median(rows[alone, 3]):.1f} ms with one felt "
            f"finger, {1e3 * np.median(rows[~alone, 3]):.1f} with several",
            flush=True,
        )


if __name__ == "__main__":
    main()
