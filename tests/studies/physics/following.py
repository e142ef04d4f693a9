"""What fingers feel while a steady drive follows one of them: ramps, crossfades, and crossfades that keep a frequency.

    python -m tests.studies.physics.following [DEVICE [RUNS]]

One finger feels 20 dB and rests; another, which is to feel nothing, moves 30 mm at 50 mm/s. A digitizer reports it 125
times a second, and the drive is solved again when it is more than 0.5 mm from where the last one was solved for. The
drives go through the synthesis of the firmware, into the plant in time, whose finger moves on every 2 ms. That is
compared with the same drives each at its own best frequency, and with these through a synthesis that ramps a channel to
zero and up again where its phase is written. SIMULATED.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.signal

from base.arrays import Array
from engine.device import Device
from engine.render.limits import clamp
from engine.steady.steady_solver import FOLLOWED_HZ
from firmware_link.emulator.drive_log import Cause, ChannelTarget, DriveEvent
from firmware_link.emulator.synthesis import synthesise
from precompute.model.assembly import assemble
from precompute.model.modal import compute_basis
from precompute.model.threshold_filter import threshold_filter
from precompute.model.transient import TransientPlant
from precompute.predict.at_positions import SteadyDesigner
from tactable.shipped import find_device
from tests.studies.options import read_options

LEVEL_DB = 20.0
RATE_HZ = 24_000
MOVED_M, SPEED_M_PER_S = 30e-3, 50e-3
REPORT_S, FOLLOW_M = 8e-3, 0.5e-3
SETTLED_S, PLANT_STEP_S, WINDOW_S = 0.4, 2e-3, 20e-3
WAYS = ("ramped", "crossfaded", "crossfaded, frequency kept")
_US_PER_S = 1e6
_MOVE_S = MOVED_M / SPEED_M_PER_S


@dataclass(frozen=True)
class Run:
    """A finger that rests and feels, and one that moves and is to feel nothing."""

    felt_m: float
    from_m: float
    to_m: float

    def quiet_m(self, time_s: float) -> float:
        """Where the moving finger is, that long after it began to move."""
        return self.from_m + (self.to_m - self.from_m) * min(max(time_s / _MOVE_S, 0.0), 1.0)


@dataclass(frozen=True)
class Felt:
    """Levels during the move, dB above threshold, of the peak for the quiet finger, of the power for the other."""

    quiet_peak_db: float
    quiet_median_db: float
    """Median of the peaks of windows of 20 ms."""
    felt_low_db: float
    """5th percentile over windows of 20 ms."""


Synthesis = Callable[[Sequence[DriveEvent], float], Array]


def crossfaded(log: Sequence[DriveEvent], stop_s: float) -> Array:
    """Displacements (time, actuator) as the firmware makes them."""
    return synthesise(log, 0.0, _US_PER_S * stop_s, RATE_HZ)


def ramped(log: Sequence[DriveEvent], stop_s: float) -> Array:
    """The same with ramps: a channel whose phase is written falls to zero as it was, then rises with its new phase."""
    out = np.zeros((math.ceil(RATE_HZ * stop_s), len(log[0].channels)))
    for actuator in range(out.shape[1]):
        events = [(math.ceil(e.device_time_us * RATE_HZ / _US_PER_S), e.channels[actuator]) for e in log]
        amplitude, playing, wanted = 0.0, (0, events[0][1]), (0, events[0][1])
        step = log[0].slew_per_s / RATE_HZ
        for sample in range(len(out)):
            if events and events[0][0] == sample:
                wanted = events.pop(0)
            if amplitude == 0.0 and sample >= wanted[0]:
                playing = wanted
            goal = playing[1].amplitude if playing is wanted else 0.0
            begun, target = playing
            assert target.phase_rad is not None  # every drive of this study writes its phases
            turned = math.tau * target.frequency_hz * (sample - begun) / RATE_HZ
            out[sample, actuator] = amplitude * math.sin(turned + target.phase_rad)
            amplitude += min(max(goal - amplitude, -step), step)
    return out


class Following:
    """Runs on one device."""

    def __init__(self, device: Device) -> None:
        self.device = device
        plant = assemble(device)
        self._basis = compute_basis(plant)
        self._solver = SteadyDesigner(device, plant).solver
        self._taps = threshold_filter(device.threshold, RATE_HZ)[:, None]

    def drives(self, run: Run, *, keeps: bool) -> list[DriveEvent]:
        """The drive that is held before the move, and those that follow: with `keeps` near the frequency before."""
        held_m = run.from_m
        log = [self._drive(run.felt_m, held_m, 0.0, None)]
        for report in range(1, round(_MOVE_S / REPORT_S) + 1):
            at_m = run.quiet_m(report * REPORT_S)
            if abs(at_m - held_m) > FOLLOW_M:
                held_m = at_m
                held_hz = log[-1].channels[0].frequency_hz if keeps else None
                log.append(self._drive(run.felt_m, held_m, SETTLED_S + report * REPORT_S, held_hz))
        return log

    def _drive(self, felt_m: float, quiet_m: float, time_s: float, held_hz: float | None) -> DriveEvent:
        fingers = sorted([(felt_m, True), (quiet_m, False)])
        position_m, is_felt = [at_m for at_m, _ in fingers], [is_felt for _, is_felt in fingers]
        solved = self._solver.solve(position_m, is_felt, LEVEL_DB, held_hz)
        targets = (ChannelTarget(c.frequency_hz, c.amplitude, c.phase_rad) for c in clamp(solved, self.device).channels)
        slew_per_s = self.device.limits.slew_per_s
        return DriveEvent(round(_US_PER_S * time_s), Cause.SET, None, slew_per_s, tuple(targets))

    def feel(self, run: Run, synthesis: Synthesis, *, keeps: bool = False) -> Felt:
        """Play a run; what both fingers feel while one moves."""
        displacement = synthesis(self.drives(run, keeps=keeps), SETTLED_S + _MOVE_S)
        begun, step = round(SETTLED_S * RATE_HZ), round(PLANT_STEP_S * RATE_HZ)
        plant, parts = TransientPlant(self._basis, np.zeros(0), RATE_HZ), list[Array]()
        for part in np.split(displacement, range(begun, len(displacement), step)):
            quiet_m = run.quiet_m((sum(map(len, parts)) + len(part) / 2 - begun) / RATE_HZ)
            plant.look_at(np.array([run.felt_m, quiet_m]))
            plant.touch([(run.felt_m, self.device.finger), (quiet_m, self.device.finger)])
            parts.append(plant.accelerate(part))
        weighted = scipy.signal.fftconvolve(np.concatenate(parts), self._taps, axes=0)[begun : len(displacement)]
        window = round(WINDOW_S * RATE_HZ)
        windows = weighted[: len(weighted) // window * window].reshape(-1, window, 2)
        peak, power = abs(windows).max(axis=1), np.sqrt(2 * np.square(windows).mean(axis=1))
        levels = (peak[:, 1].max(), np.median(peak[:, 1]), np.percentile(power[:, 0], 5))
        return Felt(*(20 * math.log10(level) for level in levels))

    def jumps(self, run: Run, *, keeps: bool) -> int:
        """How often the frequency jumps to another peak during a run."""
        hz = [event.channels[0].frequency_hz for event in self.drives(run, keeps=keeps)]
        return int((abs(np.diff(hz)) > FOLLOWED_HZ).sum())


def random_runs(device: Device, count: int, seed: int = 11) -> list[Run]:
    """Runs anywhere on the bar whose fingers are at least 30 mm apart at both ends, and so at all times."""
    random, runs, end_m = np.random.default_rng(seed), list[Run](), device.bar.length_m
    while len(runs) < count:
        felt_m, from_m = random.uniform(0.0, end_m, 2).tolist()
        to_m = from_m + MOVED_M * float(random.choice([-1.0, 1.0]))
        if 0.0 <= to_m <= end_m and min(abs(from_m - felt_m), abs(to_m - felt_m)) >= MOVED_M:
            runs.append(Run(felt_m, from_m, to_m))
    return runs


def main() -> None:
    """Print each run, and what they have in common."""
    asked = read_options(__doc__, device=("reference-a",), runs=(20,))
    device = find_device(asked.device)
    following, table = Following(device), list[tuple[bool, list[Felt]]]()
    print(f"{device.name}, SIMULATED: quiet peak, median of quiet peaks in 20 ms, felt 5 % of 20 ms, dB")
    for run in random_runs(device, asked.runs):
        ways = ((ramped, False), (crossfaded, False), (crossfaded, True))
        felt = [following.feel(run, synthesis, keeps=keeps) for synthesis, keeps in ways]
        jumps = [following.jumps(run, keeps=keeps) for keeps in (False, True)]
        table.append((jumps[0] > 0, felt))
        places = f"felt {1e3 * run.felt_m:.0f} mm, quiet {1e3 * run.from_m:.0f} to {1e3 * run.to_m:.0f} mm"
        shown = "; ".join(f"{name} {_shown([each])}" for name, each in zip(WAYS, felt, strict=True))
        print(f"{places}, jumps {jumps[0]}, where a frequency is kept {jumps[1]}: {shown}", flush=True)
    for name, has_jumps in (("without a jump of the best frequency", False), ("with jumps", True)):
        chosen = [felt for jumped, felt in table if jumped is has_jumps]
        if chosen:
            by_way = zip(WAYS, zip(*chosen, strict=True), strict=True)
            shown = "; ".join(f"{way} {_shown(each)}" for way, each in by_way)
            print(f"{name}, {len(chosen)} runs, medians: {shown}")


def _shown(felt: Sequence[Felt]) -> str:
    values = np.median([(each.quiet_peak_db, each.quiet_median_db, each.felt_low_db) for each in felt], axis=0)
    return ", ".join(f"{value:.1f}" for value in values)


if __name__ == "__main__":
    main()
