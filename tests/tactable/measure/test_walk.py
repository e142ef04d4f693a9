"""A walk over bar or plate: what is complete is kept, what loopbacks show, and the result that calibrate takes."""

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from base.points import order_of
from engine.device import Device
from precompute.measurements.model import MeasurementModel
from precompute.measurements.parameters import with_changes
from precompute.measurements.types import Kind, MeasurementError
from tactable.measure.apparatus import Apparatus
from tactable.measure.board_sensor import fixed_position_m
from tactable.measure.driven_device import DrivenDevice
from tactable.measure.sensor import SensorError
from tactable.measure.simulated_bench import ConverterFlaws, SimulatedBench, SimulatedSensor
from tactable.measure.stepped_sine import AtRest, SteppedSineOptions
from tactable.measure.swept_sine import SweepOptions
from tactable.measure.walk import (
    Channel,
    Method,
    RawFolder,
    Stop,
    StopRecord,
    channels_of,
    even_walk,
    measure_walk,
    measurements_of,
    planned_walk,
)
from tactable.rig.accelerometer import AccelerometerError
from tests.engine.loop.rig import DEVICE
from tests.precompute.devices import tablet
from tests.quick import first_quick
from tests.tactable.cli.in_process import run_here, summary_of

WALK = even_walk(DEVICE, 3, [170.0, 209.0])
OPTIONS = SteppedSineOptions()
STEPPED = Method(OPTIONS)


def walked(
    folder: Path,
    walk: Sequence[Stop] = WALK,
    flaws: str = "",
    guide: Callable[[complex], None] = lambda _: None,
    method: Method = STEPPED,
    device: Device = DEVICE,
) -> tuple[StopRecord, ...]:
    bench = SimulatedBench(device, ConverterFlaws.parse(flaws), 0)
    raw = RawFolder(folder, device, walk, {"flaws": flaws})

    def go_to(position_m: complex) -> None:
        guide(position_m)
        bench.place(position_m)

    def open_driven() -> DrivenDevice:
        return DrivenDevice(device, bench, bench, (1.0,) * len(device.actuators))

    apparatus = Apparatus(SimulatedSensor(bench), open_driven, go_to, bench.turn_over)
    return measure_walk(device, walk, apparatus, method, raw)


def test_an_interrupted_walk_goes_on_where_it_stopped_and_reads_the_responses_of_the_bar(tmp_path: Path) -> None:
    visited: list[complex] = []

    def interrupt(position_m: complex) -> None:
        if len(visited) == 2:
            raise KeyboardInterrupt
        visited.append(position_m)

    with pytest.raises(KeyboardInterrupt):
        walked(tmp_path / "raw", guide=interrupt)
    before = visited.copy()
    records = walked(tmp_path / "raw", guide=visited.append)
    assert visited == [stop.position_m for stop in WALK]
    assert before == visited[:2]
    assert [record.position_m for record in records] == visited
    samples = np.load(sorted((tmp_path / "raw").glob("*.npz"))[0])
    assert sorted(samples.files) == ["identity", "record", *(f"samples_{i:03d}" for i in range(4))]
    assert samples["samples_000"].shape == (round(2 * OPTIONS.window_s * 8000), 3)
    found = measurements_of(records, DEVICE, 2e-3, Kind.RESPONSE, is_simulated=True)
    assert len(found) == 3 * 2 * 2
    true = np.exp(MeasurementModel(DEVICE, found, ()).predict(np.zeros(0)).log_acceleration)
    ratio = found.acceleration / true
    assert abs(20 * np.log10(abs(ratio))).max() < 0.05
    assert abs(np.degrees(np.angle(ratio))).max() < 0.5
    peaks = measurements_of(walked(tmp_path / "raw"), DEVICE, 2e-3, Kind.PEAK, is_simulated=True)
    np.testing.assert_allclose(peaks.acceleration, abs(found.acceleration))


def test_a_swept_walk_reads_the_same_responses_of_both_actuators(tmp_path: Path) -> None:
    walk, method = even_walk(DEVICE, 1, [170.0, 209.0, 230.0]), Method(OPTIONS, SweepOptions(2.0))
    records = walked(tmp_path / "raw", walk, method=method)
    found = measurements_of(records, DEVICE, 2e-3, Kind.RESPONSE, is_simulated=True)
    assert len(found) == 2 * 3
    true = np.exp(MeasurementModel(DEVICE, found, ()).predict(np.zeros(0)).log_acceleration)
    np.testing.assert_allclose(found.acceleration, true, rtol=0.01)
    assert len(np.load(tmp_path / "raw" / "0005.59mm.npz").files) == 2 + 2 * 2  # two sweeps of each actuator


def test_a_folder_of_another_measurement_is_refused(tmp_path: Path) -> None:
    RawFolder(tmp_path / "raw", DEVICE, WALK, {"flaws": ""})
    with pytest.raises(MeasurementError, match="holds another measurement"):
        RawFolder(tmp_path / "raw", DEVICE, WALK[:2], {"flaws": ""})
    (tmp_path / "raw" / "measurement.json").write_bytes(b"\xff\xfe")  # no text
    with pytest.raises(MeasurementError, match="remove the folder"):
        RawFolder(tmp_path / "raw", DEVICE, WALK, {"flaws": ""})


@pytest.mark.parametrize("first", first_quick(range(5)))
def test_a_stop_that_is_cut_or_of_which_bits_are_flipped_is_refused_by_name(tmp_path: Path, first: int) -> None:
    raw, file = RawFolder(tmp_path / "raw", DEVICE, WALK, {}), tmp_path / "raw" / "0005.59mm.npz"
    record = StopRecord(WALK[0].position_m, AtRest(0.01, 0.0, 0.0), None, ())
    raw.write(WALK[0], record, [np.arange(6.0).reshape(3, 2)])
    whole = file.read_bytes()
    flipped = [whole[:at] + bytes([whole[at] ^ 1 << at % 8]) + whole[at + 1 :] for at in range(first, len(whole), 5)]
    for data in (*(whole[:size] for size in range(7 * first, len(whole), 35)), *flipped):
        file.write_bytes(data)
        try:
            assert raw.read(WALK[0]) == record  # a bit that says nothing, such as that of a date
        except MeasurementError as error:
            assert "0005.59mm.npz: is" in str(error) and "remove it" in str(error)


@pytest.mark.parametrize("lost", ["record", "identity"])
def test_a_stop_without_one_of_its_columns_or_of_another_measurement_is_refused_by_name(
    tmp_path: Path, lost: str
) -> None:
    raw, other = (RawFolder(tmp_path / name, DEVICE, WALK, {"level": name}) for name in ("raw", "other"))
    for stop in WALK[:2]:
        other.write(stop, StopRecord(stop.position_m, AtRest(0.01, 0.0, 0.0), None, ()), [])
    here, there = (sorted((tmp_path / "other").glob("*.npz"))[i] for i in (0, 1))
    (tmp_path / "raw" / here.name).write_bytes(here.read_bytes())
    with pytest.raises(MeasurementError, match=f"{here.name}: is of another measurement"):
        raw.read(WALK[0])
    np.savez(there, **{name: column for name, column in np.load(here).items() if name != lost})
    with pytest.raises(MeasurementError, match=f"{there.name}: is damaged"):
        other.read(WALK[1])
    there.write_bytes(here.read_bytes())
    with pytest.raises(MeasurementError, match=f"{there.name}: is of another .* place"):
        other.read(WALK[1])


def test_a_planned_walk_reads_what_the_plan_proposes_from_one_end_to_the_other() -> None:
    walk = planned_walk(DEVICE, 10, 2e-3)
    places_m = [stop.position_m for stop in walk]
    assert places_m == sorted(set(places_m), key=order_of)
    assert 10 <= sum(len(stop.tones) for stop in walk) <= 20
    assert all(60 <= hz <= 300 for stop in walk for _, hz in stop.tones)


TWO_STOPS = even_walk(DEVICE, 2, [170.0, 209.0])
TONES_HZ = (84.0, 276.0)


@given(st.floats(0.2, 5.0), st.sampled_from((1.0, -1.0)), st.floats(-2.5e-3, 2.5e-3))
def test_two_tones_tell_gain_sign_and_delay(gain: float, sign: float, delay_s: float) -> None:
    true = Channel(sign * gain, delay_s)
    first, found = channels_of(TONES_HZ, [np.array([1.0, true.factor(hz)]) for hz in TONES_HZ])
    assert (first.gain, first.delay_s) == (1.0, 0.0)
    assert found.gain == pytest.approx(true.gain) and found.delay_s == pytest.approx(delay_s, abs=1e-9)


def test_a_channel_that_is_late_is_told_by_the_loopbacks_and_its_responses_are_those_of_the_command(
    tmp_path: Path,
) -> None:
    records = walked(tmp_path / "raw", TWO_STOPS, "late=125us,drift=40")
    assert not records[1].channels  # once a walk
    assert records[0].channels[1].delay_s == pytest.approx(125e-6, abs=1e-6)
    assert records[0].channels[1].gain == pytest.approx(1.0, abs=1e-3)
    late = with_changes(DEVICE, {"actuator[2].delay": 125e-6})
    found = measurements_of(records, DEVICE, 2e-3, Kind.RESPONSE, is_simulated=True)
    ratios = [
        found.acceleration / np.exp(MeasurementModel(device, found, ()).predict(np.zeros(0)).log_acceleration)
        for device in (late, DEVICE)
    ]
    right = found.amplitude[:, 1] != 0
    assert abs(np.degrees(np.angle(ratios[0]))).max() < 0.5
    turned = np.degrees(np.angle(ratios[1]))
    assert turned[right] == pytest.approx(-360 * 125e-6 * found.frequency_hz[right, 1], abs=0.5)
    kept = RawFolder(tmp_path / "raw", DEVICE, TWO_STOPS, {"flaws": "late=125us,drift=40"})
    assert kept.read(TWO_STOPS[0]) == records[0]


def test_loopbacks_that_are_equal_to_the_last_bit_tell_nothing(tmp_path: Path) -> None:
    records = walked(tmp_path / "raw", TWO_STOPS[:1])
    assert records[0].channels == ()
    same = measurements_of(records, DEVICE, 2e-3, Kind.RESPONSE, is_simulated=True)
    told = (replace(records[0], channels=(Channel(1.0, 0.0), Channel(1.02, 0.0))),)
    more = measurements_of(told, DEVICE, 2e-3, Kind.RESPONSE, is_simulated=True)
    factor = np.where(same.amplitude[:, 1] != 0, 1.02, 1.0)
    np.testing.assert_allclose(more.acceleration, factor * same.acceleration)


def test_measure_prints_what_the_loopbacks_show(tmp_path: Path) -> None:
    bench = ("--port", "simulated", "--sensor", "simulated", "--flaws", "late=50us")
    words = ("measure", "reference-a", "-o", "bar.csv", *bench, "--places", "1", "--frequencies", "209")
    done = run_here(tmp_path, *words)
    told = re.search(r"channels, by their loopbacks: right plays \+(\S+) us after left, with (\S+) of its", done.stdout)
    assert told is not None, done.stdout
    assert [float(each) for each in told.groups()] == pytest.approx([50.0, 1.0], abs=0.002, rel=0.002)
    summary = summary_of(tmp_path, *words)
    assert list(summary["channels"]) == ["left", "right"]


# Damped, so that tones are steady soon.
PLATE = replace(tablet(), surface=replace(tablet().surface, mass_damping_per_s=60.0))


@pytest.mark.long
def test_a_walk_over_points_reads_what_the_model_says_and_goes_on_after_an_interruption(tmp_path: Path) -> None:
    walk = tuple(replace(stop, tones=stop.tones[:1]) for stop in even_walk(PLATE, 4, [118.5])[1:3])
    assert [stop.position_m for stop in walk] == pytest.approx([0.294 + 0.0036j, 0.006 + 0.1764j])
    guided: list[complex] = []
    for stops in (walk[:1], walk):
        for _ in range(2):  # the second time everything is kept
            records = walked(tmp_path / str(len(stops)), stops, guide=guided.append, device=PLATE)
    assert guided == [walk[0].position_m, *(stop.position_m for stop in walk)]
    read = measurements_of(records, PLATE, 2e-3, Kind.RESPONSE, is_simulated=True)
    expected = np.exp(MeasurementModel(PLATE, read, ()).predict(np.zeros(0)).log_acceleration)
    assert read.acceleration == pytest.approx(expected, rel=5e-3)
    with pytest.raises(AccelerometerError, match="310 x 10 mm is off the plate of 300 x 180 mm"):
        SimulatedBench(PLATE, ConverterFlaws(), seed=1).place(0.31 + 0.01j)


def test_a_sensor_is_fixed_at_a_point_and_a_plan_names_points() -> None:
    assert fixed_position_m("board:35x60mm", PLATE) == pytest.approx(0.035 + 0.06j)
    for text in ("board:35mm", "board:35x600mm"):
        with pytest.raises(SensorError, match=text):
            fixed_position_m(text, PLATE)
    assert all(isinstance(stop.position_m, complex) for stop in planned_walk(PLATE, 3, 2e-3))
