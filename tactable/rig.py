"""The simulated rig: recorded touches to the engine, the wire, the emulated firmware and the bar. All SIMULATED."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from engine.device import Device
from engine.digitizer import open_digitizer
from engine.entry import Entry
from engine.latency import LatencyRecorder
from engine.limits import link_configuration
from engine.loop import Loop, LoopCounters, StateChange, SystemClock, connect
from engine.renderer import Renderer
from engine.sources.playback import Playback
from engine.sources.recording import Recording
from engine.table import Table
from engine.zones import ZoneTracker
from firmware_link.drive_log import Cause, DriveEvent
from firmware_link.emulator import EmulatorLog, run_emulator
from firmware_link.link import Link
from firmware_link.serial_port import SerialPort
from firmware_link.session import Session
from firmware_link.synthesis import synthesise
from precompute.assembly import assemble
from precompute.modal import Basis, compute_basis
from precompute.transient import TransientPlant

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
        """The drive event in the firmware that a state change caused; None if its command was replaced or lost."""
        if change.drive_sequence is None:
            return None
        since_us = (change.time_ns - self.log.host_ns_at_device_zero) / 1e3
        events = (e for e in self.log.events if e.cause is Cause.SET and e.device_time_us >= since_us)
        return next((e for e in events if e.sequence == change.drive_sequence), None)


def play(table: Table, recording: Recording, speed: float) -> LiveRun:
    """Replay touches at `speed` times real pace through the engine to an emulated firmware behind a pseudo-terminal.

    Raises what the engine raises: DigitizerError, DescriptorError, LinkError, LimitError, RendererError.
    """
    device, clock = table.device, SystemClock()
    digitizer = open_digitizer(recording.descriptor, recording.vendor_id, recording.product_id)
    tracker = ZoneTracker(device, digitizer.surface)
    trace, latency = list[StateChange](), LatencyRecorder()
    count = len(device.actuators)
    with run_emulator(number_of_actuators=count) as emulator, SerialPort(emulator.port) as port:
        link = Link(link_configuration(device, PTY_BIT_RATE_HZ))
        session = Session(link, port, clock.now_ns)
        renderer = Renderer(table.entries, device, connect(session, clock))
        source = Playback(recording, speed)
        # A machine that stalls for 250 ms latches the firmware, as it should: the run greets it again and goes on.
        loop = Loop(source, digitizer, tracker, renderer, session, clock, reconnect=True, trace=trace, latency=latency)
        loop.run()
        log = emulator.stop()
    return LiveRun(tuple(trace), replace(loop.counters), link.counters.sent + link.counters.renewed, latency, log)


@dataclass(frozen=True)
class Measured:
    """Steady state of a drive that the firmware was sent, held: per zone, and at the measured points."""

    share: Array
    peak: Array
    position_m: Array
    acceleration: Array


@dataclass(frozen=True)
class Felt:
    """Envelopes over a run, a value every ENVELOPE_S, fingers loading the bar.

    drive (time, actuator): fractions of full scale; acceleration (time,): the greatest under any finger, m/s^2.
    """

    time_s: Array
    drive: Array
    acceleration: Array


class SimulatedBar:
    """The time-domain plant of one device, driven by what the emulated firmware synthesises."""

    def __init__(self, device: Device) -> None:
        self.device = device
        self.basis: Basis = compute_basis(assemble(device))
        self.sample_rate_hz = SAMPLES_PER_CYCLE * max(device.sweep.stop_hz, *(a.band_hz[1] for a in device.actuators))
        self.point_m = np.linspace(0.0, device.bar.length_m, MEASURED_POINTS)

    def measure_held(self, event: DriveEvent, entry: Entry) -> Measured:
        """Hold the firmware's drive of `event`, bar untouched, until it is steady; then measure.

        Steady: the peaks of two windows of whole beats differ by less than 0.1 % of the greatest. The peak of a zone is
        looked for at 33 places and where the table promises it.
        """
        zones = self.device.zones
        places = [np.linspace(zone.start_m, zone.stop_m, 33) for zone in zones]
        places = [np.append(p, z.peak_position_m) for p, z in zip(places, entry.zones, strict=True)]
        plant = TransientPlant(self.basis, np.concatenate([self.point_m, *places]), self.sample_rate_hz)
        window_us = _window_s(event) * _US_PER_S
        log, start_us, before = [replace(event, device_time_us=0)], 0.0, np.zeros(0)
        while True:
            displacement = synthesise(log, start_us, start_us + window_us, self.sample_rate_hz)
            acceleration, energy = plant.run(displacement)
            peak = abs(acceleration).max(axis=0)
            start_us += window_us
            settled = before.size and np.max(abs(peak - before)) <= _SETTLED * peak.max()
            if settled or start_us > _LONGEST_SETTLING_S * _US_PER_S:
                break
            before = peak
        edges = np.cumsum([MEASURED_POINTS, *(len(p) for p in places)])
        by_zone = np.split(peak, edges[:-1])[1:]
        return Measured(
            share=energy / energy.sum(),
            peak=np.array([values.max() for values in by_zone]),
            position_m=self.point_m,
            acceleration=peak[:MEASURED_POINTS],
        )

    def feel(self, run: LiveRun, longest_s: float) -> Felt:
        """What happened on the bar with the fingers on it, over the first `longest_s` of a run that has a trace."""
        zero_ns = run.log.host_ns_at_device_zero
        changes = [(max(0.0, (c.time_ns - zero_ns) / 1e3), c.finger_positions_m) for c in run.trace]
        start_us = changes[0][0]
        stop_us = min(changes[-1][0] + _RING_DOWN_US, start_us + longest_s * _US_PER_S)
        drive, felt = list[Array](), list[Array]()
        plant = TransientPlant(self.basis, np.zeros(0), self.sample_rate_hz)
        for (time_us, fingers), (next_us, _) in zip(changes, [*changes[1:], (stop_us, ())], strict=True):
            if time_us >= stop_us:
                break
            displacement = synthesise(run.log.events, time_us, min(next_us, stop_us), self.sample_rate_hz)
            plant.look_at(np.array(fingers))
            plant.touch([(position_m, self.device.finger) for position_m in fingers])
            drive.append(abs(displacement))
            felt.append(abs(plant.run(displacement)[0]).max(axis=1, initial=0.0))
        block = round(self.sample_rate_hz * ENVELOPE_S)
        drives, feels = np.concatenate(drive), np.concatenate(felt)
        whole = len(feels) // block * block
        return Felt(
            time_s=ENVELOPE_S * np.arange(whole // block, dtype=np.float64),
            drive=drives[:whole].reshape(-1, block, drives.shape[1]).max(axis=1),
            acceleration=feels[:whole].reshape(-1, block).max(axis=1),
        )


def _window_s(event: DriveEvent) -> float:
    """About half a second, whole beats of the two tones: over whole beats the cross terms of (10) vanish."""
    tones = sorted({channel.frequency_hz for channel in event.channels if channel.amplitude > 0})
    if len(tones) < 2:
        return _WINDOW_S
    beat_hz = min(b - a for a, b in itertools.pairwise(tones))
    return max(1, round(_WINDOW_S * beat_hz)) / beat_hz


def first_applied(run: LiveRun, states: Sequence[int]) -> dict[int, DriveEvent]:
    """For each of `states` that reached the firmware: the first drive event it caused."""
    found: dict[int, DriveEvent] = {}
    for change in run.trace:
        event = run.applied(change)
        if change.state in states and change.state not in found and event is not None:
            found[change.state] = event
    return found
