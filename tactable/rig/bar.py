"""The bar and its fingers in the time domain, driven by what the emulated firmware was sent. SIMULATED."""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from engine.device import Device
from engine.table import Entry
from engine.touch import ZoneState
from engine.touch.finger_tracker import ZoneEdges
from firmware_link.emulator import DriveEvent, synthesise
from precompute.model.assembly import assemble
from precompute.model.modal import Basis, compute_basis
from precompute.model.transient import TransientPlant
from tactable.rig.rig import LiveRun

Array = NDArray[np.float64]

POINTS = 22
"""The number of places along the bar that the paper measured."""
SAMPLES_PER_CYCLE = 80
"""Samples in a period of the highest frequency: straight lines between them cost 5e-4 of the amplitude."""
ENVELOPE_S = 0.01
_RING_DOWN_US = 200_000
_WINDOW_S = 0.5
_LONGEST_SETTLING_S = 8.0
_SETTLED = 1e-3
_US_PER_S = 1e6


@dataclass(frozen=True)
class Simulated:
    """Steady state of a drive that the firmware was sent, held, with fingers on the bar.

    share, peak (zone,); at_finger (zone,), NaN where there is none; acceleration (point,) at position_m. All m/s^2.
    """

    share: Array
    peak: Array
    at_finger: Array
    position_m: Array
    acceleration: Array


@dataclass(frozen=True)
class SimulatedClick:
    """What a waveform that the firmware was sent does from rest, with fingers on the bar.

    drive (time, actuator): fractions of full scale; acceleration (time, finger) in m/s^2, in the order of the zones.
    """

    time_s: Array
    drive: Array
    acceleration: Array


@dataclass(frozen=True)
class Felt:
    """Envelopes over a run, a value every ENVELOPE_S, fingers loading the bar.

    drive (time, actuator): fractions of full scale; acceleration (time,): the greatest under any finger, m/s^2; felt,
    quiet (time,): the greatest under the fingers that are to feel at that moment, or of which it still rings down, and
    under the others.
    """

    time_s: Array
    drive: Array
    felt: Array
    quiet: Array

    @property
    def acceleration(self) -> Array:
        """Shape (time,): the greatest under any finger, m/s^2."""
        return np.maximum(self.felt, self.quiet)


class SimulatedBar:
    """The time-domain plant of one device, driven by what the emulated firmware synthesises."""

    def __init__(self, device: Device) -> None:
        self.device = device
        self.basis: Basis = compute_basis(assemble(device))
        self.sample_rate_hz = SAMPLES_PER_CYCLE * max(device.sweep.stop_hz, *(a.band_hz[1] for a in device.actuators))
        self.point_m = np.linspace(0.0, device.bar.length_m, POINTS)
        self._edges = ZoneEdges(device)

    def simulate_held(self, event: DriveEvent, entry: Entry) -> Simulated:
        """Hold the firmware's drive of `event` until the bar is steady.

        A standard finger lies at the middle of every zone that the entry is touched in, as the table has it. Steady:
        the peaks of two windows of whole beats differ by less than 0.1 % of the greatest. The peak of a zone is looked
        for at 33 places and where the table promises it.
        """
        zones = self.device.zones
        middle_m = np.array([(zone.start_m + zone.stop_m) / 2 for zone in zones])
        touched = [zone.state is not ZoneState.FREE for zone in entry.zones]
        places = [np.linspace(zone.start_m, zone.stop_m, 33) for zone in zones]
        places = [np.append(p, z.peak_position_m) for p, z in zip(places, entry.zones, strict=True)]
        plant = TransientPlant(self.basis, np.concatenate([self.point_m, middle_m, *places]), self.sample_rate_hz)
        plant.touch([(position_m, self.device.finger) for position_m in middle_m[touched]])
        share, peak = _settle(plant, event)
        points, middles, *by_zone = np.split(peak, np.cumsum([POINTS, *map(len, [middle_m, *places[:-1]])]))
        return Simulated(
            share=share,
            peak=np.array([values.max() for values in by_zone]),
            at_finger=np.where(touched, middles, np.nan),
            position_m=self.point_m,
            acceleration=points,
        )

    def simulate_click(self, event: DriveEvent, states: Sequence[ZoneState]) -> SimulatedClick:
        """Play the firmware's waveform of `event` from rest, with standard fingers in the middle of touched zones."""
        zones = [zone for zone, state in zip(self.device.zones, states, strict=True) if state is not ZoneState.FREE]
        middle_m = np.array([(zone.start_m + zone.stop_m) / 2 for zone in zones])
        plant = TransientPlant(self.basis, middle_m, self.sample_rate_hz)
        plant.touch([(position_m, self.device.finger) for position_m in middle_m.tolist()])
        log = [replace(event, device_time_us=0)]
        drive = synthesise(log, 0.0, _RING_DOWN_US, self.sample_rate_hz)
        acceleration = plant.accelerate(drive)
        return SimulatedClick(np.arange(len(drive)) / self.sample_rate_hz, drive, acceleration)

    def feel(self, run: LiveRun, longest_s: float) -> Felt:
        """Simulate the first `longest_s` of a run with its fingers on the bar."""
        stretches = list(_stretches(run, longest_s))
        drive, felt, quiet = list[Array](), list[Array](), list[Array]()
        plant = TransientPlant(self.basis, np.zeros(0), self.sample_rate_hz)
        for stretch in stretches:
            displacement = synthesise(run.log.events, stretch.start_us, stretch.stop_us, self.sample_rate_hz)
            if not len(displacement):
                continue
            fingers_m = np.array(stretch.finger_positions_m)
            plant.look_at(fingers_m)
            plant.touch([(position_m, self.device.finger) for position_m in fingers_m])
            under, feels = abs(plant.accelerate(displacement)), self._feels(stretch)
            drive.append(abs(displacement))
            felt.append(under[:, feels].max(axis=1, initial=0.0))
            quiet.append(under[:, ~feels].max(axis=1, initial=0.0))
        drive_envelope, *envelopes = (self._envelope(np.concatenate(values)) for values in (drive, felt, quiet))
        return Felt(ENVELOPE_S * np.arange(len(drive_envelope), dtype=np.float64), drive_envelope, *envelopes)

    def _feels(self, stretch: "_Stretch") -> NDArray[np.bool_]:
        """Shape (finger,): whether the finger is in a felt zone; within the hysteresis of an edge, in either zone."""
        state_of = [stretch.state // 3**zone % 3 for zone in range(len(self.device.zones))]
        zones = (self._edges.zone_at(position_m) for position_m in stretch.finger_positions_m)
        return np.array([zone is not None and state_of[zone] == ZoneState.FELT for zone in zones], dtype=np.bool_)

    def _envelope(self, values: Array) -> Array:
        """The greatest value of each ENVELOPE_S, along the first axis."""
        block = round(self.sample_rate_hz * ENVELOPE_S)
        whole = len(values) // block * block
        envelope: Array = values[:whole].reshape(-1, block, *values.shape[1:]).max(axis=1)
        return envelope


@dataclass(frozen=True)
class _Stretch:
    """A stretch of time with resting fingers; `state` is the wanted state, or while it rings down the one before."""

    start_us: float
    stop_us: float
    state: int
    finger_positions_m: tuple[float, ...]


def _stretches(run: LiveRun, longest_s: float) -> Iterator[_Stretch]:
    zero_ns = run.log.host_ns_at_device_zero
    times_us = [max(0.0, (change.time_ns - zero_ns) / 1e3) for change in run.trace]
    end_us = min(times_us[-1] + _RING_DOWN_US, times_us[0] + longest_s * _US_PER_S)
    felt_state, rings_until_us = 0, 0.0
    for change, start_us, next_us in zip(run.trace, times_us, [*times_us[1:], end_us], strict=True):
        if start_us >= end_us:
            break
        stop_us = min(next_us, end_us)
        if change.level_db is not None:
            felt_state, rings_until_us = change.state, stop_us + _RING_DOWN_US
            yield _Stretch(start_us, stop_us, change.state, change.finger_positions_m)
            continue
        fades_us = min(max(start_us, rings_until_us), stop_us)
        yield _Stretch(start_us, fades_us, felt_state, change.finger_positions_m)
        yield _Stretch(fades_us, stop_us, change.state, change.finger_positions_m)


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
