"""Public bars that others measured, against the model: how near it comes, and that a fit which misses is doubted.

docs/theory.md (Measured and never measured) states these figures with their sources.
"""

from pathlib import Path

import numpy as np
import pytest

from engine.table import Table
from precompute.builder.table_build import build_table
from precompute.calibration.adequacy import adequacy_report
from precompute.calibration.modal_fit import modal_report
from precompute.measurements.response_table import measured_plant, read_responses
from precompute.model.assembly import assemble
from precompute.model.gram import compute_gram
from precompute.model.response import solve_response
from tests.precompute import fitted_bars
from tests.precompute.measured_bars import needs_bars, ruler, ruler_csv

pytestmark = needs_bars


def test_a_free_beam_has_the_models_modes_to_a_quarter_of_a_per_cent_and_their_shapes() -> None:
    fit = fitted_bars.fitted_beam().fit
    assert (abs(fit.off[0]) < 2.5e-3).all() and fit.number.tolist() == [1, 2, 3, 4, 5, 6]
    assert (fit.assurance > 0.999).all()
    assert 0.1 < abs(fit.off[1]).max() < 0.5  # two dampings stand for six: not as near
    assert "damping ratio" in modal_report(fit)["adequacy"]["doubt"]


def test_its_responses_are_met_to_three_tenths_of_a_decibel() -> None:
    found = fitted_bars.beam_calibration()
    ratio = found.measurements.acceleration / found.predicted
    assert np.median(abs(20 * np.log10(abs(ratio)))) < 0.35
    assert np.degrees(np.median(abs(np.angle(ratio)))) < 2


@pytest.mark.long
def test_the_fit_of_its_responses_is_doubted() -> None:
    found = fitted_bars.beam_calibration(every=40)
    report = adequacy_report(found.device, found, {})
    assert "too narrow" in report["doubt"]  # beside resonances so sharp, a thousandth of a frequency shows
    assert report["remedy"]["name"] == "bar.length" and report["remedy"]["length_m"] == pytest.approx(1.0, abs=2e-3)
    millimetres = f"{1e3 * report['remedy']['length_m']:.4g} mm"
    assert f"Measure bar.length again: with {millimetres} in the device file" in report["doubt"]


def test_a_ruler_has_the_models_modes_to_a_third_of_a_per_cent() -> None:
    fit = fitted_bars.fitted_ruler().fit
    assert (abs(fit.off[0]) < 3.5e-3).all() and fit.number.tolist() == [1, 2, 3, 4]
    assert (fit.assurance > 0.9).all()


def test_a_table_of_the_rulers_responses_has_the_energy_where_the_model_has_it(tmp_path: Path) -> None:
    """Shares of kinetic energy by zone over frequency, measured against the fitted model's."""
    device = ruler()
    responses = read_responses(ruler_csv(tmp_path), device, scales_forces=True)
    build_table(device, tmp_path / "ruler.nc", clicks_up_to=0, responses=responses)
    fitted, hz = assemble(fitted_bars.fitted_ruler().fit.device), device.sweep.frequency_hz
    with Table.open(tmp_path / "ruler.nc") as table:
        assert "measured" in str(table.attributes["source"])
    shares = []
    for plant in (measured_plant(device, responses), fitted):
        zones, total = compute_gram(solve_response(plant, hz))
        shares.append(zones[:, :, 0, 0].real / total[:, :1, 0].real)
    off = abs(shares[0] - shares[1])
    assert np.median(off) < 0.05 and np.percentile(off, 95) < 0.15


def test_a_clamped_bar_lies_below_an_ideal_clamp_by_nearly_one_factor() -> None:
    misses = fitted_bars.cantilever_misses()
    assert ((misses > 0.06) & (misses < 0.09)).all()
    assert np.ptp(misses) < 0.015
