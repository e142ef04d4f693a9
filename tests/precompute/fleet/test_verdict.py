"""Laws of verdicts: what speaks against the bar rejects it, what speaks against readings asks for them again."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from precompute.calibration.adequacy import adequacy_report
from precompute.calibration.calibrate import calibrate
from precompute.calibration.calibration_report import calibration_report, report_markdown
from precompute.fleet.units import FleetError, Outcome
from precompute.fleet.verdict import FEWEST, LIMITS, Judgement, judge, lot_values, read_limits
from precompute.measurements.model import Flaws
from precompute.measurements.parameters import default_names
from precompute.measurements.types import Kind
from tests.precompute.calibration.test_doubts import PARAMETER, REPORT
from tests.precompute.devices import shipped
from tests.precompute.measured import NAN, read_bar

WRONG = {"row": 30, "drive": "150 Hz", "position_m": 0.1, "measured_over_predicted": 2.5}
TURNED = {"measured_over_predicted": 1.01, "phase_off_rad": -0.2}
CONVENTION = {"doubt": "upside down", "convention": {"text": "upside down"}}


def bar(value: float = 80e9, more: dict[str, Any] | None = None, **parameter: object) -> Outcome:
    own = PARAMETER | {"value": value, "standard_error": 1e8, "interval": [value - 2e8, value + 2e8]} | parameter
    return Outcome("bar", "key", report=REPORT | {"parameters": [own], "wrong_readings": []} | (more or {}))


LOT = lot_values([bar(80e9 + 1e9 * i) for i in range(FEWEST)])


@pytest.mark.parametrize(
    ("outcome", "judgement", "word"),
    [
        (bar(), Judgement.PASS, ""),
        (bar(50e9), Judgement.REJECT, "bar.youngs_modulus is 50 GPa"),
        (bar(105e9, known="known only to be at least"), Judgement.REJECT, "above what the lot spreads over"),
        (bar(50e9, known="not identifiable"), Judgement.PASS, ""),
        (bar(30.0, name="bar.mass_damping", before=20.0, bounds=[0.0, 100.0]), Judgement.PASS, ""),
        (bar(more={"wrong_readings": [WRONG]}), Judgement.RETEST, "reading 31 (150 Hz, at 100 mm) is 2.5 times"),
        (bar(more={"wrong_readings": [WRONG | {"measured_over_predicted": 1.05}]}), Judgement.PASS, ""),
        (
            bar(more={"wrong_readings": [WRONG | TURNED]}),
            Judgement.RETEST,
            "1.01 times what the other readings say and is",
        ),
        (bar(50e9, {"adequacy": CONVENTION}), Judgement.RETEST, "upside down"),
        (bar(more={"median_misfit": 0.2}), Judgement.RETEST, "misfit"),
        (bar(more={"adequacy": {"doubt": "the length", "remedy": {}}}), Judgement.RETEST, "the length"),
        (bar(more={"adequacy": {"doubt": "the length", "remedy": {"name": "x"}}}), Judgement.REJECT, "the length"),
        (Outcome("bar", "", error="no such file"), Judgement.RETEST, "no such file"),
    ],
)
def test_the_reason_decides_the_verdict(outcome: Outcome, judgement: Judgement, word: str) -> None:
    verdict = judge(outcome, {}, LOT)
    assert (verdict.judgement, bool(verdict.reasons)) == (judgement, bool(word))
    assert word in "".join(verdict.reasons[:1])


@pytest.mark.parametrize("turned", [slice(7, 8), slice(8, 12)])  # a reading, and the readings of a drive
def test_readings_that_are_off_in_phase_alone_are_asked_for_again_by_name(turned: slice) -> None:
    device, drives_hz = shipped("reference-a"), [(150, NAN), (130, NAN), (NAN, 150), (NAN, 200)]
    read = read_bar(device, {}, drives_hz, Flaws(0.02), points=4, kind=Kind.RESPONSE)
    read.acceleration[turned] *= np.exp(1j * np.pi / 3)
    found = calibrate(device, read, default_names(device), starts=1)
    report = calibration_report(found) | {"adequacy": adequacy_report(device, found, {})}
    verdict = judge(Outcome("bar", "key", report=report), {}, {})
    assert verdict.judgement is Judgement.RETEST
    named = [f"reading {row + 1} " in reason for row, reason in zip(range(16)[turned], verdict.reasons, strict=True)]
    assert all(named) and all(re.search(r"off by (5[5-9]|6[0-5])° of phase", reason) for reason in verdict.reasons)
    assert report_markdown(report).count("° of phase") == len(named)


def test_stated_limits_stand_in_place_of_the_lot_and_need_none(tmp_path: Path) -> None:
    (tmp_path / LIMITS).write_text('"bar.youngs_modulus" = ["45 GPa", "60 GPa"]', encoding="utf-8")
    limits = read_limits(tmp_path)
    assert limits == read_limits(tmp_path / "manifest.csv") == {"bar.youngs_modulus": (45e9, 60e9)}
    assert judge(bar(50e9), limits, LOT).judgement is Judgement.PASS
    assert "33 % above the limits, 45 to 60 GPa" in judge(bar(80e9), limits, {}).reasons[0]


@pytest.mark.parametrize("text", ['"bar.width" = ["1 m", "2 m"]', '"bar.youngs_modulus" = ["2 GPa", "1 GPa"]', "[bar]"])
def test_limits_that_are_none_are_refused_by_name(tmp_path: Path, text: str) -> None:
    (tmp_path / LIMITS).write_text(text, encoding="utf-8")
    with pytest.raises(FleetError, match=rf"{LIMITS}: bar.*expected"):
        read_limits(tmp_path)
