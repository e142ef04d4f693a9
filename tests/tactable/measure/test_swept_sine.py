"""The swept sine on a simulated bench: right responses in one glide, and what spoils it is named."""

import numpy as np
import pytest

from base.arrays import Array
from tactable.measure.driven_device import DrivenDevice
from tactable.measure.faults import Fault
from tactable.measure.sensor import SensorError
from tactable.measure.simulated_bench import SimulatedBench, SimulatedSensor
from tactable.measure.stepped_sine import Reading, SteppedSine, SteppedSineOptions
from tactable.measure.swept_sine import SweepOptions, SweptSine
from tests.engine.loop.rig import DEVICE
from tests.tactable.measure.test_stepped_sine import bench_of, errors

HZ = np.array([90.0, 150.0, 170.0, 209.0])
OPTIONS = SteppedSineOptions(attempts=2)


def read(
    bench: SimulatedBench, options: SteppedSineOptions = OPTIONS, repeats: int = 1, hz: Array = HZ
) -> list[Reading]:
    with DrivenDevice(DEVICE, bench, bench, (1.0, 1.0)) as driven:
        sensor = SimulatedSensor(bench)
        stepped = SteppedSine(DEVICE, driven, sensor, options)
        stepped.listen()
        return SweptSine(stepped, SweepOptions(2.0, repeats)).read(0, hz)[0]


def test_one_glide_reads_every_frequency_whatever_latency_and_clock_are() -> None:
    bench = bench_of("latency=40ms,jitter=4ms,drift=150")
    readings = read(bench)
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
    readings = read(bench_of(flaws), SteppedSineOptions(attempts=0))
    spoiled = [reading.frequency_hz for reading in readings if fault in reading.faults]
    assert spoiled == ([150.0] if fault is Fault.HUM else HZ.tolist())


def test_without_loopback_a_sweep_is_refused_with_the_remedy() -> None:
    with pytest.raises(SensorError, match=r"loopback left.*--method stepped"):
        read(bench_of(has_loopback=False))
