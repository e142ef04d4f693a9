"""Report of a calibration: numbers for machines (JSON), and the same in words for people (Markdown)."""

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from base.arrays import Mask
from base.plain import to_plain
from base.points import json_of, point_of_json, point_text
from engine.device.quantity import interval_text, quantity_text
from precompute.calibration.calibrate import Calibration, Estimate, FittedDevice, Known
from precompute.calibration.measuring_plan import open_combinations
from precompute.measurements.types import Kind

_CORRELATED = 0.9  # either error is then 2.3 times what it is with the other value known
_UNTOLD = "- Full scale: responses per newton do not tell it. Every level rests on that of the device file: ESTIMATE."
_NEXT = "- `tactable plan-measurements` proposes the readings that tell most beside these measurements."
_LISTED = 12  # a page's worth; JSON has all


def calibration_report(calibration: Calibration) -> dict[str, Any]:
    """All results of the fit in SI, ready for JSON."""
    measurements = calibration.measurements
    return report_of_fit(calibration) | {
        "simulated": measurements.is_simulated,
        "kind": measurements.kind.value,
        "per_newton": measurements.force_m is not None,
        "readings": len(measurements),
        "median_misfit": float(np.median(np.abs(calibration.log_residual))),
        "wrong_readings": _wrong(calibration),
        "residual_by_drive": _by_drive(calibration),
        "residual_by_position": _by_position(calibration),
    }


def report_of_fit(calibration: FittedDevice) -> dict[str, Any]:
    """The part of a report about parameters, for any kind of fit."""
    return {
        "device": calibration.device.name,
        "noise": calibration.noise,
        "parameters": [_parameter(estimate) for estimate in calibration.estimates],
        "correlations": _correlations(calibration),
        "open": to_plain(open_combinations(calibration)),
    }


def _parameter(estimate: Estimate) -> dict[str, Any]:
    parameter = estimate.parameter
    return {
        "name": parameter.name,
        "symbol": parameter.symbol,
        "unit": parameter.unit,
        "before": parameter.start,
        "value": estimate.value,
        "standard_error": estimate.standard_error,
        "interval": [estimate.low, estimate.high],
        "bounds": [parameter.low, parameter.high],
        "known": estimate.known.value,
        "knee": parameter.knee,
    }


def _correlations(calibration: FittedDevice) -> list[dict[str, Any]]:
    """Correlation of every pair of parameters, the strongest first."""
    names = [parameter.name for parameter in calibration.parameters]
    pairs = [
        {"parameters": [names[i], names[j]], "correlation": float(calibration.correlation[i, j])}
        for i, j in itertools.combinations(range(len(names)), 2)
    ]
    return sorted(pairs, key=lambda pair: -abs(pair["correlation"]))


def _wrong(calibration: Calibration) -> list[dict[str, Any]]:
    measurements = calibration.measurements
    ratio = measurements.acceleration / calibration.predicted
    phase_rad = np.angle(ratio) if measurements.kind is Kind.RESPONSE else np.full(len(ratio), None)
    return [
        {
            "row": row,
            "drive": measurements.drive_text(row),
            "position_m": json_of(measurements.position_m[row].item()),
            "measured_over_predicted": float(np.exp(calibration.log_residual[row])),
            "phase_off_rad": phase_rad[row],
        }
        for row in np.flatnonzero(calibration.is_wrong).tolist()
    ]


def _by_drive(calibration: Calibration) -> list[dict[str, Any]]:
    drive = calibration.measurements.drive_of_row
    return [
        {"drive": calibration.measurements.drive_text(int(np.argmax(drive == i))), **_spread(calibration, drive == i)}
        for i in range(int(drive.max()) + 1)
    ]


def _by_position(calibration: Calibration) -> list[dict[str, Any]]:
    position_m = calibration.measurements.position_m
    return [{"position_m": json_of(x.item()), **_spread(calibration, position_m == x)} for x in np.unique(position_m)]


def _spread(calibration: Calibration, rows: Mask) -> dict[str, Any]:
    """Statistics of ln(measured / predicted): its median is the bias, the median of its size the scatter."""
    residual = calibration.log_residual[rows]
    return {
        "readings": len(residual),
        "median": float(np.median(residual)),
        "median_size": float(np.median(np.abs(residual))),
        "greatest": float(residual[np.argmax(np.abs(residual))]),
    }


def report_markdown(report: dict[str, Any]) -> str:
    """The report as a Markdown page."""
    marked = " SIMULATED" if report["simulated"] else ""
    parts = [
        f"# Calibration of {report['device']}{marked}",
        f"{report['readings']} readings ({report['kind']}); typical misfit "
        f"{_percent(report['median_misfit'])}, noise of a reading {_percent(report['noise'])}.",
        _parameters_markdown(report["parameters"]),
        f"Flash the board with `{report['flash']}`, so that HELLO says what was fitted."
        if "flash" in report and not report.get("adequacy", {}).get("doubt")
        else "",
        "## What the data leave open",
        open_text(report),
        "## Correlations of the parameters",
        _correlations_markdown(report["correlations"]),
        *(_modes_markdown(report["modes"]) if "modes" in report else _residuals_markdown(report)),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def _modes_markdown(modes: Sequence[dict[str, Any]]) -> list[str]:
    rows = [
        [
            str(mode["mode"]),
            *(f"{mode[key]:.6g} Hz" for key in ("frequency_hz", "fitted_hz")),
            *("" if mode[key] is None else _percent(mode[key]) for key in ("damping_ratio", "fitted_damping_ratio")),
            f"{mode['modal_assurance']:.3g}",
        ]
        for mode in modes
    ]
    header = ["mode of the model", "frequency", "fitted", "damping ratio", "fitted", "modal assurance criterion"]
    return ["## Measured and fitted modes", _table(header, rows)]


def _residuals_markdown(report: dict[str, Any]) -> list[str]:
    return [
        "## Measured over fitted, less one",
        _spread_markdown("drive", [(row["drive"], row) for row in report["residual_by_drive"]][:_LISTED]),
        _spread_markdown("position", [(place_text(row["position_m"]), row) for row in report["residual_by_position"]]),
        _wrong_markdown(report["wrong_readings"]),
    ]


def _parameters_markdown(parameters: Sequence[dict[str, Any]]) -> str:
    rows = [
        [
            f"{p['name']} ({p['symbol']})",
            quantity_text(p["before"], p["unit"]),
            quantity_text(p["value"], p["unit"], 6),
            quantity_text(p["standard_error"], p["unit"], 2),
            interval_text(p["interval"], p["unit"], 5),
            p["known"],
        ]
        for p in parameters
    ]
    return _table(["parameter", "before", "fitted", "standard error", "95 % interval", ""], rows)


def open_text(report: dict[str, Any]) -> str:
    """Combinations that the data leave open and parameters that are not well known, line by line."""
    lines = [f"- {combination['text']}." for combination in report["open"]]
    lines += [_UNTOLD] if report.get("per_newton") else []
    unsure = [p for p in report["parameters"] if p["known"] != Known.WELL.value]
    for p in unsure:
        error = quantity_text(p["standard_error"], p["unit"], 2)
        lines.append(f"- {p['name']} is {_known_text(p)}, its standard error {error}.")
    lines += [_NEXT] if unsure else []
    return "\n".join(lines) or "Nothing: every parameter is known within a factor of 2 or better."


def _known_text(parameter: dict[str, Any]) -> str:
    low, high = (quantity_text(end, parameter["unit"], 3) for end in parameter["interval"])
    return {
        Known.AT_MOST.value: f"at most {high}",
        Known.AT_LEAST.value: f"at least {low}",
        Known.NOT.value: "not identifiable",
    }.get(parameter["known"], interval_text(parameter["interval"], parameter["unit"], 3))


def phase_text(wrong: Mapping[str, Any]) -> str:
    """How far the phase of a wrong reading is off, to follow its factor; empty for a peak, which has none."""
    phase_rad = wrong.get("phase_off_rad")  # reports of earlier versions have none
    return "" if phase_rad is None else f" and is off by {math.degrees(phase_rad):.0f}° of phase"


def place_text(value: Any) -> str:
    """A place of a report in words, to a tenth of a millimetre."""
    return point_text(point_of_json(value), 1, "f")


def _correlations_markdown(correlations: Sequence[dict[str, Any]]) -> str:
    strong = [pair for pair in correlations if abs(pair["correlation"]) >= _CORRELATED]
    lines = [f"- {' and '.join(pair['parameters'])}: {pair['correlation']:+.3f}" for pair in strong]
    return "\n".join(lines) or f"No two are correlated by {_CORRELATED} or more."


def _spread_markdown(title: str, rows: Sequence[tuple[str, dict[str, Any]]]) -> str:
    cells = [
        [name, str(row["readings"]), *(_percent(math.expm1(row[key])) for key in ("median", "median_size", "greatest"))]
        for name, row in rows
    ]
    return _table([title, "readings", "median", "median size", "greatest"], cells)


def _wrong_markdown(wrong: Sequence[dict[str, Any]]) -> str:
    if not wrong:
        return "No reading is off by more than four times the noise."
    lines = [
        f"- {row['drive']} at {place_text(row['position_m'])}: {row['measured_over_predicted']:.2f} times the fitted"
        f"{phase_text(row)}"
        for row in wrong[:_LISTED]
    ]
    more = [f"- and {len(wrong) - _LISTED} more"] if len(wrong) > _LISTED else []
    return "\n".join([f"Readings that are off by more than four times the noise: {len(wrong)}.", "", *lines, *more])


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _percent(value: float) -> str:
    return f"{100 * value:.3g} %"
