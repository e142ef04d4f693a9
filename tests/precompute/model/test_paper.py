"""What the paper and docs/theory.md say of the two bars in figures, found again from the shipped descriptions."""

from functools import cache

import numpy as np
import pytest
from scipy.linalg import eigh

from base.arrays import Complex
from engine.device import Device
from precompute.model.assembly import assemble_bar, dense
from precompute.model.gram import compute_gram
from precompute.model.response import solve_response
from precompute.studies.reach_along import compute_acceleration_curves
from tests.precompute.devices import damped_as_assembly, shipped


@pytest.mark.parametrize(
    ("name", "printed_hz", "rounding_hz"),
    [("reference-a", [34.0, 121.8, 179.4, 208.6, 247.5, 379.4], 0.05), ("reference-d", [95, 207, 275, 448], 0.5)],
)
def test_undamped_natural_frequencies(name: str, printed_hz: list[float], rounding_hz: float) -> None:
    plant = assemble_bar(shipped(name))
    found_hz = np.sqrt(eigh(dense(plant.K), dense(plant.M), eigvals_only=True)) / 2 / np.pi
    for found, printed in zip(found_hz, printed_hz, strict=False):
        assert found == pytest.approx(printed, abs=rounding_hz + 5e-4 * printed)


@pytest.mark.parametrize(
    ("device", "printed_ms"),
    [
        (shipped("reference-a"), [24, 70, 81, 227, 878]),
        (damped_as_assembly(shipped("reference-a")), [16, 22, 30.5, 68, 873]),
    ],
    ids=["bar", "assembly"],
)
def test_decays_of_the_modes_of_reference_a_below_300_hz(device: Device, printed_ms: list[float]) -> None:
    plant = assemble_bar(device)
    K, C, M = (dense(band) for band in (plant.K, plant.C, plant.M))
    nothing, one = np.zeros_like(K), np.eye(plant.size)
    first_order = np.block([[nothing, one], [-np.linalg.solve(M, K), -np.linalg.solve(M, C)]])
    pole = np.linalg.eigvals(first_order)
    decay_s = -1 / pole.real[(pole.imag > 0) & (np.abs(pole) < 2 * np.pi * 300)]
    assert 1e3 * np.sort(decay_s) == pytest.approx(printed_ms, abs=0.5)


@cache
def swept(finger_in_zone: int | None = None) -> tuple[Complex, Complex]:
    """Zone Gram matrices and their total: REF-A, 60-300 Hz, 1 Hz."""
    device = shipped("reference-a")
    plant = assemble_bar(device)
    if finger_in_zone is not None:
        zone = device.zones[finger_in_zone]
        plant = plant.with_fingers([(zone.start_m + zone.stop_m) / 2], device.finger)
    return compute_gram(solve_response(plant, np.arange(60.0, 301.0)))


def best_coherent(zones: list[int], finger_in_zone: int | None = None) -> tuple[float, int, Complex]:
    """Largest localized factor over frequency, amplitudes and phase; index of its frequency; its drive."""
    gram, total = swept(finger_in_zone)
    found = [eigh(R, T) for R, T in zip(gram[:, zones].sum(axis=1), total, strict=True)]
    index = int(np.argmax([values[-1] for values, _ in found]))
    return float(found[index][0][-1]), index, found[index][1][:, -1]


def test_a_finger_in_zone_i_spoils_the_unloaded_optimum_and_a_new_one_mends_it() -> None:
    unloaded, index, drive = best_coherent([0])
    gram, total = swept(finger_in_zone=0)
    spoiled = (drive.conj() @ gram[index, 0] @ drive).real / (drive.conj() @ total[index] @ drive).real
    assert unloaded == pytest.approx(0.944, abs=0.002)
    assert spoiled == pytest.approx(0.159, abs=0.002)
    assert best_coherent([0], finger_in_zone=0)[0] == pytest.approx(0.695, abs=0.002)


def test_one_finger_can_feel_1_6_to_2_4_g_in_every_zone() -> None:
    device = shipped("reference-a")
    middle_m = np.array([(zone.start_m + zone.stop_m) / 2 for zone in device.zones])
    _, reached_g = compute_acceleration_curves(assemble_bar(device), middle_m, device.finger)
    assert [reached_g.max(axis=0).min(), reached_g.max()] == pytest.approx([1.6, 2.4], abs=0.05)
