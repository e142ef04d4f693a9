"""Stepped and swept sines on a simulated bench: right responses, and every flaw named by what it spoils."""

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from base.arrays import Array
from precompute.measurements.model import MeasurementModel
from precompute.measurements.types import Kind, lay_out
from tactable.measure.driven_device import DrivenDevice
from tactable.measure.faults import GRAVITY_M_PER_S2, Fault, check_gravity
from tactable.measure.sensor import Block, SensorError
from tactable.measure.simulated_bench import ConverterFlaws, SimulatedBench, SimulatedSensor
from tactable.measure.stepped_sine import Reading, SteppedSine, SteppedSineOptions
from tactable.measure.swept_sine import SweepOptions, SweptSine
from tests.engine.loop.rig import DEVICE
from tests.quick import first_quick
from tests.tools.virtual import MS

MASS_KG = 2e-3
PLACE_M = 0.05


@contextmanager
def stepping(
    bench: SimulatedBench, options: SteppedSineOptions | None = None, sensor: SimulatedSensor | None = None
) -> Iterator[SteppedSine]:
    with DrivenDevice(DEVICE, bench, bench, (1.0, 1.0)) as driven:
        stepped = SteppedSine(DEVICE, driven, sensor or SimulatedSensor(bench), options or SteppedSineOptions())
        stepped.listen()
        yield stepped


class BusyHost(SimulatedBench):
    """A bench whose host stands still for longer than a lease, again and again for a while."""

    period_ns = until_ns = due_ns = stall_ns = 0

    def be_busy(self, period_ns: int, duration_ns: int, stall_ns: int = 60 * MS) -> None:
        self.period_ns, self.until_ns, self.due_ns = period_ns, self.time_ns + duration_ns, self.time_ns
        self.stall_ns = stall_ns

    def wait(self, until_ns: int | None, readable: Sequence[int], writable: Sequence[int]) -> Sequence[int]:
        if self.due_ns <= self.time_ns < self.until_ns:
            self.due_ns = self.time_ns + self.period_ns
            self.run_to(self.time_ns + self.stall_ns)
        return super().wait(until_ns, readable, writable)


def read_while_busy(period_ns: int, duration_ns: int, **options: bool) -> Reading:
    bench = bench_of("", BusyHost, **options)
    with stepping(bench) as stepped:
        bench.be_busy(period_ns, duration_ns)
        return stepped.read(0, 209)[0]


class LosingSensor(SimulatedSensor):
    """Loses every sample for a while, and then delivers some that are not numbers."""

    lost_until_ns = 0.0
    odd = 0.0

    def read(self) -> Block | None:
        block = super().read()
        if block is None:
            return None
        if block.arrived_ns >= self.lost_until_ns:
            values = block.values.copy()
            values[: 0 if self.odd == 0 else 3, 0] = self.odd
            return replace(block, values=values)
        return replace(block, values=np.full_like(block.values, np.nan))


def read_after_loss(duration_ns: float, odd: float = 0.0) -> Reading:
    bench = bench_of()
    sensor = LosingSensor(bench)
    sensor.odd = odd
    with stepping(bench, sensor=sensor) as stepped:
        sensor.lost_until_ns = bench.time_ns + duration_ns
        return stepped.read(0, 209)[0]


def bench_of(flaws: str = "", kind: type[Any] = SimulatedBench, **options: bool) -> Any:
    bench = kind(DEVICE, ConverterFlaws.parse(flaws), 1, MASS_KG, **options)
    bench.place(PLACE_M)
    return bench


def read(bench: SimulatedBench, actuator: int, hz: float, options: SteppedSineOptions | None = None) -> Reading:
    with stepping(bench, options) as stepped:
        return stepped.read(actuator, hz)[0]


def true_response(reading: Reading) -> complex:
    """What the finite elements give at the sensor with its mass on the bar, for this amplitude."""
    drive = np.full((1, 2), np.nan)
    drive[0, reading.actuator] = reading.frequency_hz
    layout = lay_out(drive, np.array([PLACE_M]), MASS_KG, Kind.RESPONSE)
    response = MeasurementModel(DEVICE, layout, ()).predict(np.zeros(0)).log_acceleration
    return complex(reading.amplitude * np.exp(response[0]))


def errors(reading: Reading) -> Array:
    """Of the response, in dB and in degrees."""
    ratio = reading.acceleration / true_response(reading)
    return abs(np.array([20 * np.log10(abs(ratio)), np.degrees(np.angle(ratio))]))


@pytest.mark.parametrize(
    ("flaws", "actuator", "hz", "faults"),
    [
        ("", 0, 70.0, ()),
        ("", 1, 209.0, ()),
        ("latency=40ms,jitter=4ms,drift=150", 0, 209.0, (Fault.CLOCK_DRIFT,)),
        ("offset=9m/s^2", 0, 209.0, ()),
        ("offset=12m/s^2", 0, 209.0, (Fault.OFFSET,)),
        ("offset=-12m/s^2", 0, 209.0, (Fault.OFFSET,)),
    ],
)
def test_a_reading_is_the_response_of_the_bar_with_the_sensor_on_it_whatever_latency_clock_and_offset_are(
    flaws: str, actuator: int, hz: float, faults: tuple[Fault, ...]
) -> None:
    reading = read(bench_of(flaws), actuator, hz)
    assert all(errors(reading) < np.array([0.05, 0.5]))
    assert reading.drift == pytest.approx(150e-6 * ("drift" in flaws), abs=5e-6)
    assert reading.coherence == pytest.approx(1.0, abs=1e-3)
    assert (reading.faults, reading.attempts, reading.amplitude) == (faults, 1, 0.05)


@cache
def flawless(hz: float) -> Reading:
    return read(bench_of(), 0, hz, SteppedSineOptions(attempts=2))


@pytest.mark.parametrize(
    ("flaws", "hz", "fault"),
    [
        ("noise=3m/s^2", 110, Fault.NOISE),
        ("hum=0.5m/s^2", 150, Fault.HUM),
        ("clip=0.05m/s^2", 209, Fault.CLIPPING),
        ("drops=8", 209, Fault.LOST_SAMPLES),
        ("stall=0s", 209, Fault.STALLED),
        ("stall=1.6s,noise=0.01m/s^2", 209, Fault.STALLED),
    ],
)
def test_a_flaw_is_named_by_the_reading_that_it_spoils(flaws: str, hz: float, fault: Fault) -> None:
    reading = read(bench_of(flaws), 0, hz, SteppedSineOptions(attempts=2))
    assert fault in reading.faults
    assert reading.is_spoiled
    assert fault not in flawless(hz).faults


@pytest.mark.parametrize("odd", first_quick([math.nan, 3e38, math.inf, -math.inf], 2))
def test_samples_that_are_no_numbers_spoil_their_reading(odd: float) -> None:
    reading = read_after_loss(0, odd)
    assert {Fault.LOST_SAMPLES, Fault.NOISE} & {*reading.faults} and reading.is_spoiled
    assert math.isfinite(abs(reading.acceleration))


def test_windows_without_a_sample_are_taken_again_and_a_channel_that_stays_lost_is_refused() -> None:
    reading = read_after_loss(800 * MS)
    assert (reading.faults, reading.earlier) == ((), (Fault.LOST_SAMPLES,))
    assert errors(reading)[0] < 0.05
    with pytest.raises(SensorError, match="a channel has lost all its samples: check its connection"):
        read_after_loss(math.inf)


def test_the_level_rises_only_where_noise_demands_it_and_never_above_the_greatest() -> None:
    options = SteppedSineOptions(most=0.3)
    bench = bench_of("noise=1m/s^2")
    reading = read(bench, 0, 170, options)
    assert reading.amplitude == pytest.approx(0.3)
    amplitudes = [event.channels[0].amplitude for event in bench.firmware.drive_log]
    assert amplitudes[0] == pytest.approx(0.05, abs=1e-4)
    assert max(amplitudes) <= 0.3 + 1e-4
    assert errors(reading)[0] < 0.6


def test_a_reading_that_clips_is_taken_again_at_a_third() -> None:
    bench = bench_of("noise=0.02m/s^2,clip=1m/s^2")
    with stepping(bench, SteppedSineOptions(least=0.1)) as stepped:
        stepped.read(0, 70)  # hardly moves the bar, and so raises the level
        reading, _ = stepped.read(0, 209)
    assert Fault.CLIPPING not in reading.faults
    assert abs(reading.acceleration) < 1


def test_without_loopback_the_magnitude_is_known_and_no_phase() -> None:
    reading = read(bench_of(has_loopback=False), 0, 209)
    assert reading.acceleration == pytest.approx(abs(true_response(reading)), rel=0.01)


def test_a_board_that_stopped_itself_is_armed_again_and_the_reading_taken_again() -> None:
    bench = bench_of("", BusyHost)
    with stepping(bench) as stepped:
        bench.be_busy(1, 1, 400 * MS)
        reading, _ = stepped.read(0, 209)
    assert stepped.rearmed == 1
    assert errors(reading)[0] < 0.05


@pytest.mark.parametrize("has_loopback", first_quick([False, True]))
def test_a_drive_that_goes_on_lapsing_spoils_its_reading(has_loopback: bool) -> None:
    reading = read_while_busy(700 * MS, 60_000 * MS, has_loopback=has_loopback)
    assert reading.is_spoiled
    assert reading.faults == (Fault.LAPSED,)


def test_a_bar_that_rings_after_a_lapse_is_waited_for_again() -> None:
    reading = read_while_busy(400 * MS, 3_000 * MS)
    assert reading.faults == ()
    assert Fault.LAPSED in reading.earlier
    assert errors(reading)[0] < 0.05


def test_gravity_tells_gain_and_offset_apart_and_a_sensor_that_is_turned() -> None:
    flaws = replace(ConverterFlaws.parse("gain=3%,offset=0.7m/s^2"), has_gravity=True)
    bench, means = SimulatedBench(DEVICE, flaws, 1), []
    for _ in range(2):
        with DrivenDevice(DEVICE, bench, bench, (1.0, 1.0)) as driven:
            means.append(SteppedSine(DEVICE, driven, SimulatedSensor(bench), SteppedSineOptions()).listen().mean)
        bench.turn_over()
    found = check_gravity(means[0], means[1])
    assert found.gain == pytest.approx(0.03, abs=1e-4)
    assert found.offset_m_per_s2 == pytest.approx(0.7, abs=1e-3)
    assert found.faults == (Fault.GAIN, Fault.OFFSET)
    assert check_gravity(GRAVITY_M_PER_S2, -GRAVITY_M_PER_S2).faults == ()
    assert check_gravity(-GRAVITY_M_PER_S2, GRAVITY_M_PER_S2).faults == (Fault.TURNED,)


HZ = np.array([90.0, 150.0, 170.0, 209.0])
OPTIONS = SteppedSineOptions(attempts=2)


def swept(bench: SimulatedBench, options: SteppedSineOptions = OPTIONS) -> list[Reading]:
    with stepping(bench, options) as stepped:
        return SweptSine(stepped, SweepOptions(2.0, 1)).read(0, HZ)[0]


def test_one_glide_reads_every_frequency_whatever_latency_and_clock_are() -> None:
    bench = bench_of("latency=40ms,jitter=4ms,drift=150")
    readings = swept(bench)
    assert all((errors(reading) < np.array([0.05, 0.5])).all() for reading in readings)
    assert readings[0].drift == pytest.approx(150e-6, abs=5e-6)
    assert {fault for reading in readings for fault in reading.faults} == {Fault.CLOCK_DRIFT}
    amplitudes = [event.channels[0].amplitude for event in bench.firmware.drive_log]
    assert max(amplitudes) == pytest.approx(OPTIONS.least, abs=1e-4)
    assert all(event.channels[1].amplitude == 0 for event in bench.firmware.drive_log)


@pytest.mark.parametrize(
    ("flaws", "fault"),
    [
        ("clip=0.05m/s^2", Fault.CLIPPING),
        ("drops=3", Fault.LOST_SAMPLES),
        ("hum=1m/s^2", Fault.HUM),
        ("stall=3s", Fault.STALLED),
        ("offset=20m/s^2", Fault.OFFSET),
    ],
)
def test_a_flaw_is_named_by_what_it_spoils(flaws: str, fault: Fault) -> None:
    readings = swept(bench_of(flaws), SteppedSineOptions(attempts=0))
    spoiled = [reading.frequency_hz for reading in readings if fault in reading.faults]
    assert spoiled == ([150.0] if fault is Fault.HUM else HZ.tolist())


def test_without_loopback_a_sweep_is_refused_with_the_remedy() -> None:
    with pytest.raises(SensorError, match=r"loopback left.*--method stepped"):
        swept(bench_of(has_loopback=False))
