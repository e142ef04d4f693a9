"""The simulated rig: recorded touches to the engine, the wire, the emulated firmware and the bar. All SIMULATED."""

import itertools
from contextlib import ExitStack
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from engine.device import Device
from engine.effects import DEFAULT_EFFECTS, Effects
from engine.entry import Entry
from engine.latency import LatencyRecorder
from engine.loop import LoopCounters, StateChange, SystemClock
from engine.sources.playback import Playback
from engine.sources.recording import Recording
from engine.table import Table
from engine.zones import ZoneEdges, ZoneState
from firmware_link.drive_log import Cause, DriveEvent, Outcome, ReceivedFrame
from firmware_link.emulator import EmulatorLog, run_emulator
from firmware_link.reopening import ReopeningPort
from firmware_link.serial_port import SerialPort
from firmware_link.synthesis import synthesise
from precompute.assembly import assemble
from precompute.modal import Basis, compute_basis
from precompute.transient import TransientPlant
from tactable.live import Live, LiveOptions

Array = NDArray[np.float64]

MEASURED_POINTS = 22
"""As many places along the bar as the paper measured."""
SAMPLES_PER_CYCLE = 80
"""Samples in a period of the highest frequency: straight lines between them cost 5e-4 of the amplitude."""
PTY_BIT_RATE_HZ = 2_000_000
ENVELOPE_S = 0.01
_RING_DOWN_US = 200_000
_WINDOW_S = 0.5
_LONGEST_SETTLING_S = 8.0
_SETTLED = 1e-3
_US_PER_S = 1e6
_SEQUENCES = 256
_SET = "SET"


@dataclass(frozen=True)
class LiveRun:
    """What happened between touch and firmware: the loop's trace and figures, the firmware's own log."""

    trace: tuple[StateChange, ...]
    counters: LoopCounters
    frames_sent: int
    """SET frames, renewals of the lease included."""
    latency: LatencyRecorder
    log: EmulatorLog

    def applied(self, change: StateChange) -> DriveEvent | None:
        """What the firmware drove once it had taken the command of a state change; None if it never took it.

        A command that came late is refused as stale; its renewals bring the same drive as long as the state lasts.
        """
        frame = next((f for f in self._frames(change) if f.outcome is Outcome.ACCEPTED), None)
        if frame is None:
            return None
        # A drive that plays already is no event, and several frames of one read have the same time.
        before = [event for event in self.log.events if _is_before(event, frame)]
        return before[-1] if before and before[-1].cause is Cause.SET else None

    def came_late(self, change: StateChange) -> bool:
        """Whether the firmware refused the command and all its renewals, as it does when the machine has stalled."""
        frames = self._frames(change)
        return bool(frames) and all(frame.outcome is not Outcome.ACCEPTED for frame in frames)

    def _frames(self, change: StateChange) -> list[ReceivedFrame]:
        """The command of a state change and its renewals, as the firmware received them; a terminal loses none."""
        since_us = (change.time_ns - self.log.host_ns_at_device_zero) / 1e3
        # Sequences come again after that many.
        frames = [frame for frame in self.log.received if frame.device_time_us >= since_us][:_SEQUENCES]
        sequences = [frame.sequence for frame in frames]
        if change.drive_sequence not in sequences:
            return []
        command, *later = frames[sequences.index(change.drive_sequence) :]
        following = (c.drive_sequence for c in self.trace[self.trace.index(change) + 1 :])
        next_sequence = next((sequence for sequence in following if sequence is not None), None)
        renewals = itertools.takewhile(lambda frame: frame.sequence != next_sequence, later)
        return [command, *(frame for frame in renewals if frame.message == _SET)]


def play(
    table: Table, recording: Recording, speed: float, effects: Effects = DEFAULT_EFFECTS, faults: str = ""
) -> LiveRun:
    """Replay touches at `speed` times real pace through the engine to an emulated firmware behind a pseudo-terminal.

    `faults` is a text for `parse_fault_plan`: stalls and delays; a line that loses frames is no pseudo-terminal.
    Raises what the engine raises: DigitizerError, DescriptorError, LinkError, LimitError, RendererError.
    """
    # A machine that stalls for 250 ms latches the firmware, as it should: the run greets it again and goes on. If one
    # of the two processes stalls for a second, the port is opened anew.
    options, trace = LiveOptions(effects, reconnect=True, bit_rate_hz=PTY_BIT_RATE_HZ), list[StateChange]()
    count = len(table.device.actuators)
    with ExitStack() as stack:
        emulator = stack.enter_context(run_emulator(count, faults=faults))
        port = SerialPort(emulator.port)
        reopening = ReopeningPort(lambda: SerialPort(emulator.port), port)
        stack.callback(reopening.close)
        live = Live(table, Playback(recording, speed), port, SystemClock(), options, trace, reopening)
        live.run()
        log = emulator.stop()
    return LiveRun(tuple(trace), replace(live.loop.counters), live.frames_sent, live.latency, log)


def _is_before(event: DriveEvent, frame: ReceivedFrame) -> bool:
    """Whether an event was there once a frame had been taken."""
    if event.device_time_us != frame.device_time_us or event.sequence is None:
        return event.device_time_us <= frame.device_time_us
    return (frame.sequence - event.sequence) % _SEQUENCES < _SEQUENCES // 2


@dataclass(frozen=True)
class Measured:
    """Steady state of a drive that the firmware was sent, held, with fingers on the bar.

    share, peak (zone,); at_finger (zone,), NaN where there is none; acceleration (point,) at position_m. All m/s^2.
    """

    share: Array
    peak: Array
    at_finger: Array
    position_m: Array
    acceleration: Array


@dataclass(frozen=True)
class Felt:
    """Envelopes over a run, a value every ENVELOPE_S, fingers loading the bar.

    drive (time, actuator): fractions of full scale; acceleration (time,): the greatest under any finger, m/s^2; felt,
    quiet (time,): the greatest under the fingers that are to feel at that moment, and under the others.
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
        self.point_m = np.linspace(0.0, device.bar.length_m, MEASURED_POINTS)
        self._edges = ZoneEdges(device)

    def measure_held(self, event: DriveEvent, entry: Entry) -> Measured:
        """Hold the firmware's drive of `event` until the bar is steady; then measure.

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
        points, middles, *by_zone = np.split(peak, np.cumsum([MEASURED_POINTS, *map(len, [middle_m, *places[:-1]])]))
        return Measured(
            share=share,
            peak=np.array([values.max() for values in by_zone]),
            at_finger=np.where(touched, middles, np.nan),
            position_m=self.point_m,
            acceleration=points,
        )

    def feel(self, run: LiveRun, longest_s: float) -> Felt:
        """What happened on the bar with the fingers on it, over the first `longest_s` of a run that has a trace."""
        zero_ns = run.log.host_ns_at_device_zero
        times_us = [max(0.0, (change.time_ns - zero_ns) / 1e3) for change in run.trace]
        stop_us = min(times_us[-1] + _RING_DOWN_US, times_us[0] + longest_s * _US_PER_S)
        drive, felt, quiet = list[Array](), list[Array](), list[Array]()
        plant = TransientPlant(self.basis, np.zeros(0), self.sample_rate_hz)
        for change, time_us, next_us in zip(run.trace, times_us, [*times_us[1:], stop_us], strict=True):
            if time_us >= stop_us:
                break
            displacement = synthesise(run.log.events, time_us, min(next_us, stop_us), self.sample_rate_hz)
            fingers_m = np.array(change.finger_positions_m)
            plant.look_at(fingers_m)
            plant.touch([(position_m, self.device.finger) for position_m in fingers_m])
            under, feels = abs(plant.run(displacement)[0]), self._feels(change)
            drive.append(abs(displacement))
            felt.append(under[:, feels].max(axis=1, initial=0.0))
            quiet.append(under[:, ~feels].max(axis=1, initial=0.0))
        drive_envelope, *envelopes = (self._envelope(np.concatenate(values)) for values in (drive, felt, quiet))
        return Felt(ENVELOPE_S * np.arange(len(drive_envelope), dtype=np.float64), drive_envelope, *envelopes)

    def _feels(self, change: StateChange) -> NDArray[np.bool_]:
        """Shape (finger,): whether it lies in a felt zone; at an edge, within the hysteresis, either may be so."""
        state_of = [change.state // 3**zone % 3 for zone in range(len(self.device.zones))]
        zones = (self._edges.zone_at(position_m) for position_m in change.finger_positions_m)
        return np.array([zone is not None and state_of[zone] == ZoneState.FELT for zone in zones], dtype=np.bool_)

    def _envelope(self, values: Array) -> Array:
        """The greatest of each ENVELOPE_S along the first axis."""
        block = round(self.sample_rate_hz * ENVELOPE_S)
        whole = len(values) // block * block
        envelope: Array = values[:whole].reshape(-1, block, *values.shape[1:]).max(axis=1)
        return envelope


def _settle(plant: TransientPlant, event: DriveEvent) -> tuple[Array, Array]:
    """Share of each zone and peak at each point of the plant, once two windows agree."""
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
    """About half a second, whole beats of the two tones: over whole beats the cross terms of (10) vanish."""
    tones = sorted({channel.frequency_hz for channel in event.channels if channel.amplitude > 0})
    if len(tones) < 2:
        return _WINDOW_S
    beat_hz = min(b - a for a, b in itertools.pairwise(tones))
    return max(1, round(_WINDOW_S * beat_hz)) / beat_hz


StateAndLevel = tuple[int, float]


def first_applied(run: LiveRun) -> dict[StateAndLevel, DriveEvent]:
    """For each state and level that was felt and reached the firmware: the first drive event it caused."""
    found: dict[StateAndLevel, DriveEvent] = {}
    for change in run.trace:
        event = run.applied(change)
        if change.level_db is not None and event is not None:
            found.setdefault((change.state, change.level_db), event)
    return found
