"""Laws of measured responses: those that the model would give make the model's table; what is missing is named."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from base.arrays import Array
from engine.device import Device
from engine.table import Table
from precompute.builder.measured_responses import interpolation_errors_of, plant_of, source_attributes
from precompute.builder.table_build import build_table
from precompute.measurements.csv import write_csv
from precompute.measurements.model import Flaws, even_places, simulate_measurements
from precompute.measurements.response_table import MeasuredResponses, estimate_errors, measured_plant, read_responses
from precompute.measurements.types import CalibrationError, Kind, Measurements, lay_out
from precompute.model.assembly import assemble
from precompute.model.plant import Plant
from precompute.model.response import solve_response
from precompute.sampling.steady_modes import steady_basis, steady_modes
from precompute.sweep.grid import compute_grid_response, zone_points
from tests.precompute.devices import shipped
from tests.precompute.fleet.small_fleet import small_text

REFERENCE = shipped("reference-a")
COARSE = Device.parse(small_text(), "coarse")
SMALL_HZ = np.arange(60.0, 301.0, 2.0)


def measured(device: Device, frequency_hz: Array, places: int = 22, noise: float = 0.0) -> MeasuredResponses:
    """What the model would answer at even places, read with relative noise."""
    place_m = even_places(device, places)
    acceleration = solve_response(assemble(device), frequency_hz).acceleration(place_m)
    random = np.random.default_rng(1)
    flaw = random.standard_normal(acceleration.shape) + 1j * random.standard_normal(acceleration.shape)
    return MeasuredResponses(frequency_hz, place_m, acceleration * (1 + noise * flaw), "bar.csv", "5ha", True)


def rows(device: Device, frequency_hz: Array, places: int, sensor_mass_kg: float = 0.0) -> Measurements:
    """The same as rows of a file, every actuator alone."""
    each = np.full((len(frequency_hz), len(device.actuators), len(device.actuators)), np.nan)
    for i in range(len(device.actuators)):
        each[:, i, i] = frequency_hz
    drives = each.reshape(-1, len(device.actuators))
    layout = lay_out(drives, even_places(device, places), sensor_mass_kg, Kind.RESPONSE)
    return simulate_measurements(device, layout, Flaws(), 0)


def relative_error(device: Device, plant: Plant, frequency_hz: Array) -> Array:
    """Of accelerations relative to the greatest at the frequency: (frequency, actuator, zone, point)."""
    found, true = (
        compute_grid_response(each, frequency_hz, zone_points(device)).acceleration
        for each in (plant, assemble(device))
    )
    error: Array = abs(found - true) / abs(true).max(axis=(2, 3), keepdims=True)
    return error


def test_the_errors_are_upper_bounds_and_the_model_agrees_with_itself() -> None:
    for step_hz in (0.5, 2.0):
        hz = np.arange(60.0, 300.0 + step_hz / 2, step_hz)
        responses = measured(REFERENCE, hz)
        errors = estimate_errors(REFERENCE, responses)
        plant = measured_plant(REFERENCE, responses)
        between = relative_error(REFERENCE, plant, (hz[:-1] + hz[1:]) / 2).max(axis=(0, 2, 3))
        at = relative_error(REFERENCE, plant, hz).max(axis=(0, 2, 3))
        assert at.max() < 2e-3
        assert (at <= errors.between_places).all()
        assert (between <= errors.between_places + errors.between_frequencies).all()
        assert errors.model.max() < 1e-9


def written(folder: Path, device: Device, measurements: Measurements) -> Path:
    path = folder / "bar.csv"
    path.write_text(write_csv(measurements, device, "SIMULATED"), encoding="utf-8")
    return path


def test_a_file_is_read_in_any_order_at_any_amplitude_and_the_sensor_is_taken_off(tmp_path: Path) -> None:
    hz = np.arange(60.0, 301.0, 60.0)
    whole = rows(COARSE, hz, 6, sensor_mass_kg=2e-3)
    order = np.random.default_rng(0).permutation(len(whole))
    half = replace(whole, amplitude=0.5 * whole.amplitude, acceleration=0.5 * whole.acceleration)
    found = read_responses(written(tmp_path, COARSE, half.part(order)), COARSE)
    expected = solve_response(assemble(COARSE), hz).acceleration(even_places(COARSE, 6))
    assert np.allclose(found.frequency_hz, hz)
    assert np.allclose(found.position_m, even_places(COARSE, 6))
    assert abs(found.acceleration - expected).max() < 1e-4 * abs(expected).max()
    assert abs(whole.acceleration).max() != pytest.approx(abs(expected).max(), rel=1e-3)
    assert found.is_simulated
    assert found.name == "bar.csv"


@pytest.mark.parametrize(
    ("change", "parts"),
    [
        (lambda m: m.part(np.arange(1, len(m))), ("left at 60 Hz and 5.588 mm is missing", "first of 1")),
        (lambda m: m.part(m.position_m < 0.1), ("places", "4")),
        (
            lambda m: m.part(np.nan_to_num(m.frequency_hz).max(axis=1) < 200),
            ("reaches from 60 to 180 Hz", "60 to 300 Hz"),
        ),
        (lambda m: m.part(np.append(np.arange(len(m)), 3)), ("twice",)),
        (lambda m: replace(m, finger_m=np.full(len(m), 0.1)), ("finger",)),
        (lambda m: replace(m, kind=Kind.PEAK, acceleration=abs(m.acceleration) + 0j), ("peak", "complex responses")),
        (
            lambda m: replace(m, frequency_hz=np.full_like(m.frequency_hz, 60), amplitude=np.ones_like(m.amplitude)),
            ("more than one actuator",),
        ),
    ],
)
def test_what_is_missing_or_unfit_is_refused_by_name(tmp_path: Path, change: object, parts: tuple[str, ...]) -> None:
    assert callable(change)
    path = written(tmp_path, COARSE, change(rows(COARSE, np.arange(60.0, 301.0, 60.0), 6)))
    with pytest.raises(CalibrationError) as error:
        read_responses(path, COARSE)
    for part in (str(path), *parts):
        assert part in str(error.value)


def per_newton(device: Device, hz: Array, places: int, *, is_roving: bool = False) -> str:
    """A CSV text of receptances to forces at the actuators, or of sensors there while a hammer roves."""
    text = "position (mm),force position (mm),frequency (Hz),receptance real (m/N),receptance imaginary (m/N)\n"
    base_m, place_m = np.array([a.position_m for a in device.actuators]), even_places(device, places)
    columns = solve_response(assemble(device), hz, base_m)
    g = columns.acceleration(place_m)[:, len(base_m) :] / -((2 * np.pi * hz)[:, None, None] ** 2)
    for (f, a, p), value in np.ndenumerate(g):
        ends = (base_m[a], place_m[p]) if is_roving else (place_m[p], base_m[a])
        text += f"{1e3 * ends[0]:.12g},{1e3 * ends[1]:.12g},{hz[f]},{value.real:.12g},{value.imag:.12g}\n"
    return text


@pytest.mark.parametrize("is_roving", [False, True])
def test_forces_at_the_actuators_make_responses_at_full_scale(tmp_path: Path, is_roving: bool) -> None:
    path, hz = tmp_path / "bar.csv", np.arange(60.0, 301.0, 60.0)
    path.write_text(per_newton(COARSE, hz, 6, is_roving=is_roving), encoding="utf-8")
    found = read_responses(path, COARSE, scales_forces=True)
    expected = solve_response(assemble(COARSE), hz).acceleration(even_places(COARSE, 6))
    assert abs(found.acceleration - expected).max() < 1e-9 * abs(expected).max()
    assert found.is_per_newton and "full scale" in source_attributes(found)["modelled"]


def test_forces_are_scaled_only_where_asked_for_and_where_actuators_are(tmp_path: Path) -> None:
    path, hz = tmp_path / "bar.csv", np.array([60.0, 300.0])
    text = per_newton(COARSE, hz, 6)
    elsewhere = text.replace(f",{1e3 * COARSE.actuators[0].position_m:.12g},", ",100,")
    at_full_scale = write_csv(rows(COARSE, hz, 6), COARSE, "")
    for written, scales, part in (
        (text, False, "--force-of-actuators"),
        (at_full_scale, True, "leave --force-of-actuators out"),
        (elsewhere, True, "force at 100 mm: is where no actuator is"),
    ):
        path.write_text(written, encoding="utf-8")
        with pytest.raises(CalibrationError, match=part):
            read_responses(path, COARSE, scales_forces=scales)


@pytest.fixture(scope="module")
def tables(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Of the coarse device: from its model, and from measured responses every 2 Hz."""
    folder = tmp_path_factory.mktemp("tables")
    modelled, from_measured = folder / "model.nc", folder / "measured.nc"
    build_table(COARSE, modelled, created="", clicks_up_to=0)
    build_table(COARSE, from_measured, created="", clicks_up_to=0, responses=measured(COARSE, SMALL_HZ))
    return modelled, from_measured


def test_the_table_says_what_it_was_built_from(tables: tuple[Path, Path]) -> None:
    with Table.open(tables[0]) as modelled, Table.open(tables[1], device=COARSE) as from_measured:
        assert modelled.attributes["source"] == "model"
        assert from_measured.attributes["source"] == "measured responses (SIMULATED)"
        assert from_measured.attributes["responses_file"] == "bar.csv"
        assert from_measured.attributes["responses_sha256"] == "5ha"
        assert "ESTIMATE" in str(from_measured.attributes["modelled"])
        assert not from_measured.clicks
        assert set(interpolation_errors_of(from_measured)) == {
            "between_frequencies_error",
            "between_places_error",
            "model_disagreement",
        }
        assert interpolation_errors_of(from_measured)["model_disagreement"]["left"] < 1e-9


@pytest.mark.long
def test_the_same_responses_are_taken_over_and_others_are_not(tables: tuple[Path, Path], tmp_path: Path) -> None:
    path = tmp_path / "table.nc"
    path.write_bytes(tables[1].read_bytes())
    told = list[str]()
    responses = measured(COARSE, SMALL_HZ)
    for given in (responses, replace(responses, sha256="0ther")):
        told.clear()
        build_table(
            COARSE, path, created="", clicks_up_to=0, responses=given, progress=lambda step, _: told.append(step)
        )
        assert ("responses as before" in told) == (given is responses)
        with Table.open(path) as table:
            assert table.attributes["responses_sha256"] == given.sha256
            assert len(table.values("measured", "frequency")) == len(SMALL_HZ)


def test_the_plant_of_a_table_is_the_one_it_was_built_from(tables: tuple[Path, Path]) -> None:
    for path, kind in zip(tables, (False, True), strict=True):
        with Table.open(path) as table:
            assert plant_of(table).is_measured is kind
            plant = plant_of(table)
            modes = steady_modes(steady_basis(plant))
            assert np.array_equal(modes.drive, table.modes.drive) and np.array_equal(modes.shape, table.modes.shape)
