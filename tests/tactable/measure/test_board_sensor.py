"""The board's own accelerometer on a simulated bench: right responses, its clock followed, what spoils it named."""

import numpy as np
import pytest

from firmware_link.host.link_values import AccelerometerDescribed, Capabilities
from firmware_link.protocol.link_errors import LinkError
from firmware_link.protocol.messages import Acceleration
from tactable.measure.board_sensor import BoardSensor, fixed_position_m, open_board_sensor
from tactable.measure.driven_device import DrivenDevice
from tactable.measure.faults import Fault
from tactable.measure.simulated_bench import BoardBench, ConverterFlaws, SimulatedBench
from tactable.measure.stepped_sine import Reading, SteppedSine, SteppedSineOptions
from tests.engine.loop.rig import DEVICE
from tests.tactable.measure.test_stepped_sine import bench_of, errors, true_response
from tests.tools.virtual import VirtualClock

BIT_RATE_HZ = 1_000_000
RATE_HZ, SYNTHESIS_HZ = 3_200.0, 48_000


def read(bench: BoardBench, actuator: int, hz: float, **options: float) -> tuple[Reading, BoardSensor]:
    sensor = open_board_sensor(DEVICE, bench, bench, BIT_RATE_HZ)
    with DrivenDevice(DEVICE, bench, bench, (1.0, 1.0), BIT_RATE_HZ, accelerometer=sensor) as driven:
        stepped = SteppedSine(DEVICE, driven, sensor, SteppedSineOptions(**options))  # type: ignore[arg-type]
        stepped.listen()
        reading, _ = stepped.read(actuator, hz)
    sensor.close()
    return reading, sensor


@pytest.mark.parametrize(("actuator", "hz", "drift"), [(1, 209.0, 12_000), (0, 297.0, -30_000)])
def test_a_reading_is_the_response_of_the_bar_whatever_the_clock_of_the_part(
    actuator: int, hz: float, drift: int
) -> None:
    reading, sensor = read(bench_of(f"drift={drift}", BoardBench), actuator, hz, least=1.0)
    ratio = reading.acceleration / true_response(reading)
    assert abs(ratio - 1) < 4 * reading.error + 0.002
    assert all(errors(reading) < np.array([0.2, 1.5]))
    assert reading.drift == pytest.approx(1e-6 * drift, abs=5e-6)
    assert reading.faults == (Fault.CLOCK_DRIFT,)
    assert (sensor.losses.frames, sensor.losses.samples) == (0, 0)
    assert sensor.form.is_simulated


@pytest.mark.parametrize(
    ("flaws", "hz", "least", "fault"), [("", 70, 1.0, Fault.NOISE), ("offset=150m/s^2", 209, 0.05, Fault.CLIPPING)]
)
def test_what_the_part_does_not_show_is_named(flaws: str, hz: float, least: float, fault: Fault) -> None:
    reading, _ = read(bench_of(flaws, BoardBench), int(hz > 100), hz, least=least, attempts=1)
    assert fault in reading.faults
    assert reading.error > 0.02 or fault is Fault.CLIPPING


def test_a_board_without_an_accelerometer_and_a_slow_line_are_refused() -> None:
    without = SimulatedBench(DEVICE, ConverterFlaws(), 1)
    with pytest.raises(LinkError, match="no accelerometer"):
        open_board_sensor(DEVICE, without, without, BIT_RATE_HZ)
    bench = bench_of("", BoardBench)
    with pytest.raises(LinkError, match=r"115200 bit/s carries 1398 .*--bit-rate"):
        open_board_sensor(DEVICE, bench, bench, 115_200)


def a_sensor(scales: tuple[float, ...] = (1.0, 1.0), number_of_actuators: int = 2) -> BoardSensor:
    described, clock = AccelerometerDescribed(RATE_HZ, 0.5, 100, 0), VirtualClock()
    board = Capabilities(number_of_actuators, 0.01, 10.0, 1000.0, (), 100, SYNTHESIS_HZ, 1, 1)
    return BoardSensor(described, DEVICE, board, scales, clock)


def frame(index: int, number: int, values: tuple[int, ...], sample: int = 0) -> Acceleration:
    return Acceleration(index, number, sample, len(values), values)


def test_gaps_of_the_line_and_of_the_board_are_told_apart_across_the_wrap_of_the_numbers() -> None:
    sensor, one = a_sensor(), (1, 0, 0)
    sensor.take_event(frame(65_535, 2**32 - 1, one))
    sensor.take_event(frame(0, 0, one))  # the next of both
    sensor.take_event(frame(1, 4, one))  # three samples that the board lost
    sensor.take_event(frame(3, 7, one))  # a frame of two samples that the line lost
    block = sensor.read()
    assert block is not None
    assert np.isnan(block.values[:, 0]).tolist() == [False, False, True, True, True, False, True, True, False]
    assert (sensor.losses.frames, sensor.losses.samples) == (1, 3)
    sensor.begin_stream()
    sensor.take_event(frame(9, 900, one))
    block = sensor.read()
    assert block is not None and not np.isnan(block.values).any(), "what came before a stream leaves no gap"


def test_the_pace_is_the_slope_of_the_two_numbers_across_their_wraps() -> None:
    sensor, pace = a_sensor(), 1.02
    assert sensor.pace() == 0.0
    for index in range(150):
        number, sample = 2**32 - 1_000 + 32 * index, 2**32 - 20_000 + round(32 * index * 15 / pace)
        sensor.take_event(frame(index, number % 2**32, (1, 0, 0) * 32, sample % 2**32))
    assert sensor.pace() == pytest.approx(pace - 1, abs=2e-6)


def test_a_fixed_place_is_a_length_or_a_share() -> None:
    assert fixed_position_m("board", DEVICE) is None
    assert fixed_position_m("board:35mm", DEVICE) == pytest.approx(0.035)
    assert fixed_position_m("board: 25 %", DEVICE) == pytest.approx(DEVICE.bar.length_m / 4)
