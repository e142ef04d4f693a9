"""A walk along the bar: what is complete is kept, and the result is what calibrate takes."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from base.points import order_of
from precompute.measurements.model import MeasurementModel
from precompute.measurements.types import Kind, MeasurementError
from tactable.measure.apparatus import Apparatus
from tactable.measure.driven_device import DrivenDevice
from tactable.measure.simulated_bench import ConverterFlaws, SimulatedBench, SimulatedSensor
from tactable.measure.stepped_sine import AtRest, SteppedSineOptions
from tactable.measure.swept_sine import SweepOptions
from tactable.measure.walk import (
    Method,
    RawFolder,
    Stop,
    StopRecord,
    even_walk,
    measure_walk,
    measurements_of,
    planned_walk,
)
from tests.engine.loop.rig import DEVICE
from tests.quick import first_quick

WALK = even_walk(DEVICE, 3, [170.0, 209.0])
OPTIONS = SteppedSineOptions()
STEPPED = Method(OPTIONS)


def walked(
    folder: Path,
    walk: Sequence[Stop] = WALK,
    flaws: str = "",
    guide: Callable[[complex], None] = lambda _: None,
    method: Method = STEPPED,
) -> tuple[StopRecord, ...]:
    bench = SimulatedBench(DEVICE, ConverterFlaws.parse(flaws), 0)
    raw = RawFolder(folder, DEVICE, walk, {"flaws": flaws})

    def go_to(position_m: complex) -> None:
        guide(position_m)
        bench.place(position_m)

    def open_driven() -> DrivenDevice:
        return DrivenDevice(DEVICE, bench, bench, (1.0, 1.0))

    apparatus = Apparatus(SimulatedSensor(bench), open_driven, go_to, bench.turn_over)
    return measure_walk(DEVICE, walk, apparatus, method, raw)


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
