"""What is left of a click's promise on bars and fingers that differ from the model it was made with.

Clicks are solved as a run solves them, for random placements of a felt and a quiet finger. Each is played on fresh
plants with the spread of the bench and one thing changed a row, in time (plant_in_time.py): nothing is shared with the
damped lines that clicks are solved on.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import scipy.fft

from base.arrays import Array, Integers, Points
from base.points import clip_points
from engine.device import Device
from engine.device.parts import Actuator, Plate
from engine.touch import Placement
from precompute.clicks import DEFAULT_OPTIONS, ClickSolver
from precompute.clicks.click_basis import RINGDOWN_S, SAMPLE_RATE_HZ
from precompute.clicks.evaluation import decibels
from precompute.model.assembly import assemble
from precompute.model.modal import Basis, compute_basis
from precompute.model.transfers import TransferFilter, threshold_filter
from precompute.parallel.pool import WorkerPool
from precompute.sampling.placements import Anywhere, random_placements
from precompute.sampling.plants import Scenarios, sample_scenarios
from precompute.studies.plant_in_time import accelerations

FELT_DB, FAINT_DB, CLEAR_DB = 14.0, 1.0, 6.0  # felt by at least the first, quiet at most the second, or the third
SETS = ("bench", "lab", "hand")  # of spreads that clicks are made for; plants are those of the first
PLACEMENTS, SEED, RATE_HZ = 50, 34, 2 * SAMPLE_RATE_HZ
MOST_MODES, TOP_HZ = 150, 5000.0  # higher modes change accelerations by 1 % where actuators cancel, else by 0.1 %
BRANCHES = np.array([(153.7, 1.631), (121.7, 0.3228), (713.7, 0.4733), (206.1, 0.03418), (14203.0, 0.5887)])
"""Springs in series with dampers, N/m and N s/m, for a damper of order 0.7 that loses at 160 Hz what 1 N s/m does."""
_OF_BRANCHES_N_PER_M = 509.0  # their stiffness there
_BEHIND = (500.0, 2.0, 10e-3)  # ESTIMATE: what holds the bone of a fingertip, N/m and N s/m, and the bone, kg
_LIGHT_KG = 1e-6  # of a node between a spring and a damper
_BOLT = (-0.5, -0.25, 0.0, 0.25, 0.5), (0.0, 0.5, -0.5, 0.5j, -0.5j)  # points of one that spreads: on a bar, a plate


@dataclass(frozen=True)
class Change:
    """What differs from the model in one row of the table; by default nothing."""

    name: str
    bits: int = 0  # of the converter
    youngs_modulus: float = 0.0  # added, relative
    length: float = 0.0  # relative standard deviation of the surface's sides; actuators stay where they are
    damping: float = 1.0  # factor of surface and actuators
    gain: float = 0.0  # every channel is off by up to this, evenly
    late_s: float = 0.0  # the first channel
    within_m: float = 1e-3  # how far fingers are from where the digitizer tells
    onward_m: float = 0.0  # how far every quiet finger has gone along the surface, to either side
    clamp_m: float = 0.0  # length of a bar that every actuator keeps from bending
    spread_m: float = 0.0  # length over which every actuator acts
    fingers: float = 1.0  # factor up to which mass, damping and stiffness are off, log-evenly, in place of 30 %
    finger: str = ""  # "mass": behind the pulp; "fractional"


CHANGES = (
    Change("nothing"),
    Change("converter of 12 bit", bits=12),
    Change("converter of 8 bit", bits=8),
    Change("E 0.3 % less", youngs_modulus=-0.003),
    Change("gain of each channel within 5 %", gain=0.05),
    Change("length 1 %", length=0.01),
    Change("damping x 0.7", damping=0.7),
    Change("a mass behind the pulp", finger="mass"),
    Change("a fractional pulp", finger="fractional"),
    Change("position within 2 mm", within_m=2e-3),
    Change("position within 4 mm", within_m=4e-3),
    Change("one channel 50 us late", late_s=50e-6),
    Change("one channel 125 us late", late_s=125e-6),
    Change("quiet finger 3 mm on", onward_m=3e-3),
    Change("bolts that spread over 16 mm", spread_m=16e-3),
    Change("bolts that clamp 20 mm", clamp_m=20e-3),
    Change("fingers threefold", fingers=3.0),
    Change("a lab: all small ones", 12, -0.003, length=0.01, gain=0.05, late_s=50e-6, within_m=2e-3),
)


@dataclass(frozen=True)
class Kept:
    """What clicks keep in one row, over the placements; contrast: 5th percentile of felt levels less 95th of quiet."""

    faint: float  # share with the felt finger at FELT_DB or more in 95 % of the plants, the quiet at most at FAINT_DB
    clear: float  # the same with CLEAR_DB
    quiet: float  # share with the quiet finger at most at CLEAR_DB in 95 %, however much is felt
    low_contrast_db: float  # the 5th percentile over the placements
    contrast_db: float  # the 50th


def study_robustness(
    devices: Sequence[Device],
    changes: Sequence[Change],
    plants: int,
    placements: int,
    on_progress: Callable[[float], None],
    pool: WorkerPool,
) -> list[list[Kept]]:
    """What clicks keep (device, change) on fresh plants of the first device; the others differ from it in the spread.

    Raises PlacementError where the surface is too small for two fingers.
    """
    where = random_placements(devices[0], Anywhere(placements))
    solved = pool.solve_in_order(partial(solve_clicks, where), devices, lambda part: on_progress(0.1 * part))
    judge = partial(peaks_on, sample_scenarios(devices[0], plants, SEED), where, np.stack(solved, axis=1), changes)
    peaks = np.array(pool.solve_in_order(judge, range(1, plants + 1), lambda part: on_progress(0.1 + 0.9 * part)))
    felt = np.array([placement.felt[0] for placement in where])
    return [[kept_of(peaks[:, row, :, case], felt) for row in range(len(changes))] for case in range(len(devices))]


def solve_clicks(where: Sequence[Placement], device: Device) -> Array:
    """Waveforms (placement, actuator, time) of the clicks that a run plays."""
    solver = ClickSolver(device, DEFAULT_OPTIONS.at_fingers)
    return np.stack([solver.solve(placement).waveform.T for placement in where])


def kept_of(peaks: Array, felt: Integers) -> Kept:
    """What is kept, by peaks (plant, placement, finger) in units of the threshold."""
    level_db = decibels(peaks)
    felt_db, quiet_db = (np.take_along_axis(level_db, at[None, :, None], 2)[..., 0] for at in (felt, 1 - felt))
    low_db, high_db = np.percentile(felt_db, 5, axis=0), np.percentile(quiet_db, 95, axis=0)
    faint, clear = (float(((low_db >= FELT_DB) & (high_db <= most_db)).mean()) for most_db in (FAINT_DB, CLEAR_DB))
    quiet = float((high_db <= CLEAR_DB).mean())
    return Kept(faint, clear, quiet, *np.percentile(low_db - high_db, (5, 50)).tolist())


def peaks_on(
    scenarios: Scenarios, where: Sequence[Placement], waveform: Array, changes: Sequence[Change], plant: int
) -> Array:
    """Peaks (change, placement, case, finger), 1 at the threshold, of waveforms (placement, case, actuator, time)."""
    own, bases, found = scenarios.device_of(plant), dict[Device, Basis](), list[Array]()
    taps = threshold_filter(own.threshold, RATE_HZ)
    for change in changes:
        device = _changed(own, change, _random(plant, 0))
        if device not in bases:
            basis = compute_basis(assemble(device), MOST_MODES)
            bases[device] = basis.lowest(int(np.searchsorted(basis.square_omega, (2 * np.pi * TOP_HZ) ** 2)))
        basis = bases[device]
        at_m, grounded, nodes = _fingers(scenarios, plant, where, change)
        force_n = _forces(device, waveform, change, _random(plant, 1))
        shape = basis.at(at_m.ravel()).reshape(*at_m.shape, -1)
        course = accelerations(basis, shape, grounded, nodes, force_n, RATE_HZ)
        steps = course.shape[-1]
        size = scipy.fft.next_fast_len(steps + len(taps), real=True)
        weighted = scipy.fft.irfft(scipy.fft.rfft(course, size) * scipy.fft.rfft(taps, size), size)
        found.append(np.abs(weighted[..., :steps]).max(axis=-1))
    return np.array(found)


def _random(plant: int, what: int) -> np.random.Generator:
    """Random numbers of one kind of one plant: the same in every row."""
    return np.random.default_rng([SEED, plant, what])


def _changed(device: Device, change: Change, random: np.random.Generator) -> Device:
    """The device with another surface and other actuators."""
    surface, stretch = device.surface, 1 + change.length * float(random.standard_normal())
    surface = replace(
        surface,
        youngs_modulus_pa=surface.youngs_modulus_pa * (1 + change.youngs_modulus),
        length_m=surface.length_m * stretch,
        width_m=surface.width_m * (stretch if isinstance(surface, Plate) else 1.0),
        mass_damping_per_s=surface.mass_damping_per_s * change.damping,
        stiffness_damping_s=surface.stiffness_damping_s * change.damping,
    )
    offsets_m = change.spread_m * np.array(_BOLT[isinstance(surface, Plate)] if change.spread_m else (0.0,))
    share, actuators = 1 / len(offsets_m), list[Actuator]()
    for each in device.actuators:
        # What is shared is the stiffness, and with it the force: a displacement at full scale stays as it is.
        part = replace(
            each.scaled(share, share),
            damping_n_s_per_m=each.damping_n_s_per_m * share * change.damping,
            full_scale_m=each.full_scale_m,
            clamp_m=0.0 if change.spread_m else max(each.clamp_m, change.clamp_m),
        )
        at_m = clip_points(each.position_m + offsets_m, surface.corner_m).tolist()
        actuators += [replace(part, position_m=one_m) for one_m in at_m]
    return replace(device, surface=surface, actuators=tuple(actuators))


def _fingers(
    scenarios: Scenarios, plant: int, where: Sequence[Placement], change: Change
) -> tuple[Points, Array, Array]:
    """Points, and what `accelerations` calls grounded and nodes, of the fingers of all placements on one plant."""
    each = [scenarios.place(placement.position_m, change.within_m) for placement in where]
    is_quiet = ~np.array([placement.is_felt for placement in where])
    onward_m = change.onward_m * _random(plant, 2).choice((-1.0, 1.0), (len(where), 1))
    at_m = np.array([fingers.position_m[plant] for fingers in each]) + onward_m * is_quiet
    keys = ("stiffness_n_per_m", "damping_n_s_per_m", "mass_kg")
    own = np.array([[getattr(fingers, key)[plant] for key in keys] for fingers in each]).swapaxes(1, 2)
    if change.fingers != 1:
        middle = np.array([getattr(scenarios.device.finger, key) for key in keys])
        own = middle * change.fingers ** _random(plant, 3).uniform(-1, 1, own.shape)
    k, c, m = np.moveaxis(own, -1, 0)
    none, nodes = 0 * k, list[Array]()
    if change.finger == "mass":
        nodes, k, c = [np.stack([k, c, *(none + value for value in _BEHIND)], axis=-1)], none, none
    elif change.finger == "fractional":
        nodes = [np.stack([c * one, none, none, c * other, none + _LIGHT_KG], axis=-1) for one, other in BRANCHES]
        k, c = k - c * _OF_BRANCHES_N_PER_M, none
    stacked = np.stack(nodes, axis=2) if nodes else np.zeros((*k.shape, 0, 5))
    return clip_points(at_m, scenarios.device.surface.corner_m), np.stack([k, c, m], axis=-1), stacked


def _forces(device: Device, waveform: Array, change: Change, random: np.random.Generator) -> Array:
    """Forces (placement, case, actuator, time) at RATE_HZ of the actuators, until what they move has rung down."""
    channels = waveform.shape[2]
    if change.bits:
        full = 2 ** (change.bits - 1) - 1
        waveform = np.rint(waveform * full) / full
    waveform = waveform * (1 + change.gain * random.uniform(-1, 1, (channels, 1)))
    sample = np.arange(waveform.shape[-1])
    time_s = np.arange(round((sample[-1] / SAMPLE_RATE_HZ + RINGDOWN_S) * RATE_HZ)) / RATE_HZ
    out = np.empty((*waveform.shape[:2], len(device.actuators), len(time_s)))
    for index, actuator in enumerate(device.actuators):
        channel = index * channels // len(device.actuators)
        at = (time_s - actuator.delay_s - change.late_s * (channel == 0)) * SAMPLE_RATE_HZ
        for one in np.ndindex(waveform.shape[:2]):
            course = np.interp(at, sample, waveform[one][channel])
            if actuator.transfer is not None:
                course = TransferFilter(actuator.transfer, RATE_HZ).run(course)
            rate = np.gradient(course, 1 / RATE_HZ)
            out[one][index] = actuator.spring_force_n * course + actuator.damper_force_n_s * rate
    return out
