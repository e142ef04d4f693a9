"""Laws of the best rows: they are what a search of every tabulated value finds, and better than the paper's optimum."""

import itertools
import math
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import h5py
import numpy as np
import pytest

from base.arrays import Array
from engine.device import Device
from engine.table.best_rows import BestRow, BestRows, combination_of
from engine.table.netcdf_file import TableWriter
from precompute.model.assembly import assemble
from precompute.sweep.best import STEP, BestRowSearch
from precompute.sweep.grid import compute_grid_response, zone_points
from precompute.sweep.tabulate import write_coherent_sweep, write_pair_sweep
from tactable.shipped import find_device
from tests.precompute.builder.test_table_build import DEVICES

PAPER_OPTIMUM = 0.8626
"""What fmincon found in the paper for zones I, III and V (Figure 8)."""
_TWO = DEVICES["two"]
_BANDS = zip(_TWO.actuators, ((60.0, 180.0), (200.0, 300.0)), strict=True)
BARS = {
    "two": _TWO,
    "apart": replace(_TWO, actuators=tuple(replace(each, band_hz=band_hz) for each, band_hz in _BANDS)),
    "three": DEVICES["three"],
    "limited": replace(_TWO, limits=replace(_TWO.limits, amplitude=0.3)),
}
FIGURES = ("localized_factor", "peak_acceleration", "dead_spot")
Tables = dict[str, Array]


@cache
def swept(name: str, memory_budget_bytes: int = 1 << 24) -> tuple[BestRows, Tables]:
    device = BARS[name] if name in BARS else find_device(name)
    grid = compute_grid_response(assemble(device), device.sweep.frequency_hz, zone_points(device))
    best = BestRowSearch(device)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "swept.nc"
        with TableWriter(path) as writer:
            write_coherent_sweep(writer, grid, best)
            for _ in write_pair_sweep(writer, grid, best, memory_budget_bytes):
                pass
        with h5py.File(path) as file:
            names = (f"{group}/{figure}" for group in ("sweep", "coherent_sweep") for figure in FIGURES)
            return best.best_rows(), {each: file[each][...].astype(float) for each in names}


def every_row(device: Device, tables: Tables) -> tuple[Array, Array]:
    """Factor and level (row, zone) of all tabulated rows of both sweeps, level as a ratio at the amplitude limit."""
    threshold = device.threshold.peak_m_per_s2(device.sweep.frequency_hz)
    amplitude = device.sweep.amplitude
    first, second = amplitude[:, None], amplitude[None, :]
    # Two frequencies: (pair, f1, a1, a2, zone, f2); a silent actuator has no threshold, and one frequency has one.
    t1, t2 = threshold[:, None, None, None], threshold
    both = np.sqrt((first > 0)[..., None] * t1**2 + (second > 0)[..., None] * t2**2)
    one = np.eye(len(threshold), dtype=bool)[:, None, None, :]
    both = np.where(one, t1, both)
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = device.limits.amplitude / np.maximum(first, second)[..., None] / both
        level = tables["sweep/peak_acceleration"] * scale[:, :, :, None, :]
    pairs = [
        np.moveaxis(each, 4, -1).reshape(-1, len(device.zones)) for each in (tables["sweep/localized_factor"], level)
    ]
    scale = device.limits.amplitude / threshold
    level = tables["coherent_sweep/peak_acceleration"] * scale[:, None, None, None]
    factor = tables["coherent_sweep/localized_factor"]
    coherent = [np.moveaxis(each, 2, -1).reshape(-1, len(device.zones)) for each in (factor, level)]
    factor, level = (np.concatenate(each) for each in zip(coherent, pairs, strict=True))
    is_moving = np.isfinite(factor[:, 0]) & np.isfinite(level[:, 0])
    return factor[is_moving], level[is_moving]


def row_threshold(device: Device, row: BestRow) -> float:
    """The peak acceleration that counts as the threshold of a row, m/s^2."""
    hz = np.array(sorted({row.frequencies_hz[actuator] for actuator in row.sounding}))
    return float(np.hypot.reduce(device.threshold.peak_m_per_s2(hz)))


def rows_of(found: BestRows) -> Iterator[BestRow]:
    return itertools.chain.from_iterable(found.values())


@pytest.mark.parametrize("name", BARS)
def test_each_is_what_a_search_of_all_tabulated_values_finds(name: str) -> None:
    device = BARS[name]
    found, tables = swept(name)
    factor, level = every_row(device, tables)
    assert len(found) == 2 ** len(device.zones) - 1
    for row in rows_of(found):
        share, weakest = factor[:, row.zones].sum(axis=1), level[:, row.zones].min(axis=1)
        reaches = weakest >= 10 ** (row.wanted_level_db / 20) * (1 - 1e-6)
        assert row.achieved == (math.isinf(row.wanted_level_db) or bool(reaches.any()))
        if reaches.any():
            assert row.localized_factor == pytest.approx(share[reaches].max(), abs=2 * STEP)
            assert row.level_db == pytest.approx(row.wanted_level_db, abs=1e-5)
        else:
            assert 10 ** (row.level_db / 20) == pytest.approx(weakest.max(), rel=1e-5)
            assert max(row.amplitudes) == pytest.approx(device.limits.amplitude)


@pytest.mark.parametrize("name", BARS)
def test_each_is_the_tabulated_row_scaled_to_its_level(name: str) -> None:
    device = BARS[name]
    found, tables = swept(name)
    two_tones = 0
    for row in rows_of(found):
        axis = 4 if row.group == "sweep" else 2
        factor, peak, dead = (np.moveaxis(tables[f"{row.group}/{each}"], axis, -1) for each in FIGURES)
        at = np.unravel_index(row.index, factor.shape[:-1])
        assert row.shares == pytest.approx(factor[at]) and max(row.amplitudes) <= device.limits.amplitude * (1 + 1e-9)
        scale = row.peaks_m_per_s2[0] / peak[at][0]
        assert row.peaks_m_per_s2 == pytest.approx(scale * peak[at], rel=1e-6)
        assert row.dead_spots_m_per_s2 == pytest.approx(scale * dead[at], rel=1e-6)
        weakest = min(row.peaks_m_per_s2[zone] for zone in row.zones)
        assert 20 * math.log10(weakest / row_threshold(device, row)) == pytest.approx(row.level_db, abs=1e-5)
        if row.group == "sweep":
            two_tones += 1
            assert row.frequency_hz is None and len(row.sounding) == 2
            first, second = (device.sweep.frequency_hz[at[place]] for place in (1, 4))
            amplitudes = [scale * device.sweep.amplitude[at[place]] for place in (2, 3)]
            assert [row.frequencies_hz[each] for each in row.sounding] == [first, second]
            assert [row.amplitudes[each] for each in row.sounding] == pytest.approx(amplitudes)
        else:
            assert row.frequency_hz == device.sweep.frequency_hz[at[1]]
    assert two_tones or name != "apart"


def test_how_many_rows_are_tabulated_at_once_does_not_matter() -> None:
    assert list(rows_of(swept("three", 1)[0])) == list(rows_of(swept("three")[0]))


@pytest.mark.long
def test_the_best_row_for_the_zones_of_figure_8_has_a_greater_factor_than_the_solver_of_the_paper_found() -> None:
    device = find_device("reference-a")
    zones = [device.zone_index(zone) for zone in ("I", "III", "V")]
    rows = swept("reference-a")[0][combination_of(zones)]
    assert [row.achieved for row in rows] == [True] * 4
    assert all(row.localized_factor > PAPER_OPTIMUM for row in rows[:-1])
    assert rows[0].localized_factor == pytest.approx(0.966, abs=1e-3)  # PHYSICS: the global optimum of one frequency


def test_the_level_of_two_tones_is_felt_at_least() -> None:
    """By the rule of all levels, tones add in power, each over its own threshold."""
    row = next(row for row in rows_of(swept("apart")[0]) if row.group == "sweep")
    threshold = BARS["apart"].threshold.peak_m_per_s2(np.array([row.frequencies_hz[each] for each in row.sounding]))
    magnitude = np.random.default_rng(1).uniform(0, 5, (1000, 2))
    felt = np.hypot.reduce(magnitude / threshold, axis=1)
    promised = magnitude.sum(axis=1) / row_threshold(BARS["apart"], row)
    assert (promised <= felt * (1 + 1e-12)).all() and (promised / felt).max() > 0.99


@pytest.mark.parametrize("level_db", [5.0, 12.0, 19.0, 25.0, 90.0])
def test_between_two_levels_a_row_is_played_louder_or_softer_and_keeps_its_factor(level_db: float) -> None:
    found, _ = swept("two")
    for combination, rows in found.items():
        row = found.at(combination, level_db)
        assert row is not None and max(row.amplitudes) <= BARS["two"].limits.amplitude * (1 + 1e-9)
        assert row.achieved == (row.level_db >= level_db - 1e-3)
        assert row.achieved or max(row.amplitudes) == pytest.approx(BARS["two"].limits.amplitude)
        assert row.localized_factor in [each.localized_factor for each in rows]
        same = next(each for each in rows if each.localized_factor == row.localized_factor)
        change_db = 20 * math.log10(max(row.amplitudes) / max(same.amplitudes))
        assert row.level_db - same.level_db == pytest.approx(change_db) or row.index != same.index
    assert found.at(0, level_db) is None
