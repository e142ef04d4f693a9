"""The surface and its fingers in the time domain, driven by what the emulated firmware was sent. SIMULATED."""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from base.arrays import Array, Field, Points
from engine.device import Device
from engine.touch import Touch
from engine.touch.placement import CLOSEST_M
from firmware_link.emulator.drive_log import DriveEvent
from firmware_link.emulator.synthesis import synthesise
from precompute.model.assembly import assemble
from precompute.model.modal import Basis, compute_basis
from precompute.model.transient import TransientPlant
from tactable.rig.rig import LiveRun, Moment

POINTS = 22  # the most points that a held drive is shown at; the paper measured as many places along its bar
SAMPLES_PER_CYCLE = 80
"""Samples in a period of the highest frequency: straight lines between them cost 5e-4 of the amplitude."""
ENVELOPE_S = 0.01  # a third of a click
_CLICK_RATE_HZ = 48_000.0  # a force jumps at the corners of a waveform, and acceleration with it
_RING_DOWN_US = 200_000  # with fingers on it; an untouched surface may ring longer (docs/theory.md)
_WINDOW_S = 0.5  # 30 periods of 60 Hz; longer where two tones beat slower
_LONGEST_SETTLING_S = 8.0
_SETTLED = 1e-3  # 0.01 dB
_US_PER_S = 1e6


@dataclass(frozen=True)
class SimulatedDrive:
    """Steady state of a drive that the firmware was sent, held, with fingers on the surface.

    share (zone,); at_finger (finger,); acceleration (point,) at position_m. Accelerations are peaks in m/s^2.
    """

    share: Array
    at_finger: Array
    position_m: Points
    acceleration: Array


@dataclass(frozen=True)
class SimulatedClick:
    """What a waveform that the firmware was sent does from rest, with fingers on the surface.

    drive (time, actuator): fractions of full scale; acceleration (time, finger) in m/s^2.
    """

    time_s: Array
    drive: Array
    acceleration: Array

    @property
    def at_finger(self) -> Array:
        """Peaks (finger,), m/s^2."""
        peaks: Array = abs(self.acceleration).max(axis=0)
        return peaks


@dataclass(frozen=True)
class Felt:
    """Envelopes over a run, a value every ENVELOPE_S, fingers loading the surface.

    drive (time, actuator): fractions of full scale; felt, quiet (time,): the greatest acceleration, m/s^2, under the
    fingers that are to feel at that moment, or of which it still rings down, and under the others.
    """

    time_s: Array
    drive: Array
    felt: Array
    quiet: Array


class SimulatedSurface:
    """The time-domain plant of one device, driven by what the emulated firmware synthesises."""

    def __init__(self, device: Device) -> None:
        self.device = device
        self.basis: Basis = compute_basis(assemble(device))
        self.sample_rate_hz = SAMPLES_PER_CYCLE * max(device.sweep.stop_hz, *(a.band_hz[1] for a in device.actuators))
        self.point_m = Field.of(device.surface.corner_m, POINTS).position_m

    def simulate_held(self, event: DriveEvent, finger_m: Sequence[complex]) -> SimulatedDrive:
        """Hold the firmware's drive of `event` until the surface is steady, with standard fingers at these positions.

        Steady: the peaks of two windows of whole beats differ by less than 0.1 % of the greatest.
        """
        plant = self._plant(np.concatenate([self.point_m, finger_m]), finger_m)
        share, peak = _settle(plant, event)
        points = len(self.point_m)
        return SimulatedDrive(share, peak[points:], self.point_m, peak[:points])

    def simulate_click(self, event: DriveEvent, finger_m: Sequence[complex]) -> SimulatedClick:
        """Play the firmware's waveform of `event` from rest, with standard fingers at these positions."""
        plant = self._plant(np.array(finger_m), finger_m, _CLICK_RATE_HZ)
        drive = synthesise([replace(event, device_time_us=0)], 0.0, _RING_DOWN_US, _CLICK_RATE_HZ)
        acceleration = plant.accelerate(drive)
        return SimulatedClick(np.arange(len(drive)) / _CLICK_RATE_HZ, drive, acceleration)

    def _plant(self, point_m: Points, finger_m: Sequence[complex], rate_hz: float | None = None) -> TransientPlant:
        plant = TransientPlant(self.basis, point_m, rate_hz or self.sample_rate_hz)
        plant.touch([(position_m, self.device.finger) for position_m in finger_m])
        return plant

    def feel(self, run: LiveRun, longest_s: float) -> Felt:
        """Simulate the first `longest_s` of a run, its fingers on the surface where the digitizer has them."""
        drive, felt, quiet = list[Array](), list[Array](), list[Array]()
        plant, fingers_m = self._plant(np.zeros(0), ()), tuple[complex, ...]()
        for start_us, stop_us, lying_m, roles in _stretches(run, longest_s):
            displacement = synthesise(run.log.events, start_us, stop_us, self.sample_rate_hz)
            if not len(displacement):
                continue
            if not run.log.events:  # the board never heard of a drive
                displacement = np.zeros((len(displacement), len(self.device.actuators)))
            if lying_m != fingers_m:
                fingers_m = lying_m
                plant.look_at(np.array(fingers_m))
                plant.touch([(position_m, self.device.finger) for position_m in fingers_m])
            under, feels = abs(plant.accelerate(displacement)), np.array(roles, dtype=np.bool_)
            drive.append(abs(displacement))
            felt.append(under[:, feels].max(axis=1, initial=0.0))
            quiet.append(under[:, ~feels].max(axis=1, initial=0.0))
        drive_envelope, *envelopes = (self._envelope(np.concatenate(values)) for values in (drive, felt, quiet))
        return Felt(ENVELOPE_S * np.arange(len(drive_envelope), dtype=np.float64), drive_envelope, *envelopes)

    def _envelope(self, values: Array) -> Array:
        """The greatest value of each ENVELOPE_S, along the first axis."""
        block = round(self.sample_rate_hz * ENVELOPE_S)
        whole = len(values) // block * block
        envelope: Array = values[:whole].reshape(-1, block, *values.shape[1:]).max(axis=1)
        return envelope


def _stretches(run: LiveRun, longest_s: float) -> Iterator[tuple[float, float, tuple[complex, ...], tuple[bool, ...]]]:
    """The run from one frame or change to the next: start and stop in us, points of the fingers, whether each feels.

    A finger feels while it is to, and while what it felt rings down.
    A finger keeps the role that the newest placement gave it, by contact, since it may move while its click plays.
    """
    moments, zero_ns = run.moments, run.log.host_ns_at_device_zero
    times_us = [max(0.0, (moment.time_ns - zero_ns) / 1e3) for moment in moments]
    end_us = min(times_us[-1] + _RING_DOWN_US, times_us[0] + longest_s * _US_PER_S)
    placement, felt, rings_until_us = None, frozenset[int](), 0.0
    for moment, start_us, next_us in zip(moments, times_us, [*times_us[1:], end_us], strict=True):
        if start_us >= end_us:
            break
        stop_us, touches = min(next_us, end_us), moment.touches
        fades_us = stop_us
        if moment.level_db is None:
            fades_us = min(max(start_us, rings_until_us), stop_us)
        else:
            rings_until_us = stop_us + _RING_DOWN_US
            if moment.placement is not None and moment.placement != placement:
                placement = moment.placement
                felt = frozenset(touch.contact_id for touch in touches if is_felt(touch, moment))
        finger_m = tuple(touch.position_m for touch in touches)
        yield start_us, fades_us, finger_m, tuple(touch.contact_id in felt for touch in touches)
        yield fades_us, stop_us, finger_m, (False,) * len(touches)


def is_felt(touch: Touch, moment: Moment) -> bool:
    """Whether a touch is to feel at a moment: the nearest finger of the placement is, and is nearer than CLOSEST_M."""
    placement = moment.placement
    if placement is None or moment.level_db is None:
        return False
    distance_m, feels = min(
        (abs(at_m - touch.position_m), feels)
        for at_m, feels in zip(placement.position_m, placement.is_felt, strict=True)
    )
    return feels and distance_m < CLOSEST_M


def _settle(plant: TransientPlant, event: DriveEvent) -> tuple[Array, Array]:
    """Energy share of each zone and peak at each point, once two successive windows agree."""
    window_us = _window_s(event) * _US_PER_S
    log, start_us, before = [replace(event, device_time_us=0)], 0.0, np.zeros(0)
    while True:
        displacement = synthesise(log, start_us, start_us + window_us, plant.sample_rate_hz)
        acceleration, energy = plant.run(displacement)
        peak = abs(acceleration).max(axis=0)
        start_us += window_us
        settled = before.size and np.max(abs(peak - before)) <= _SETTLED * peak.max()
        if settled or start_us > _LONGEST_SETTLING_S * _US_PER_S:
            return energy / energy.sum(), peak
        before = peak


def _window_s(event: DriveEvent) -> float:
    """About half a second of whole beats between the tones: over whole beats the cross terms of eq. (10) vanish."""
    tones = sorted({channel.frequency_hz for channel in event.channels if channel.amplitude > 0})
    if len(tones) < 2:
        return _WINDOW_S
    beat_hz = min(b - a for a, b in itertools.pairwise(tones))
    return max(1, round(_WINDOW_S * beat_hz)) / beat_hz
