"""A calibration to the files of its folder: device description, raw data, report and picture."""

import hashlib
import json
from typing import Any

from engine.device_file import parse_device
from precompute.calibrated_device import calibrated_text
from precompute.calibration import Calibration
from precompute.calibration_report import report_markdown
from tactable.figure_calibration import calibration_png


def calibration_files(
    calibration: Calibration, report: dict[str, Any], raw: bytes, ending: str, created: str
) -> dict[str, bytes]:
    """Contents by name; `raw` is the file of measurements as it was, `ending` such as ".csv"."""
    name = calibration.device.name
    data_name = f"measurements{ending}"
    provenance = {
        "created": created,
        "measurements": data_name,
        "sha256": hashlib.sha256(raw).hexdigest(),
        "report": "report.json",
        "loss": calibration.loss.value,
    }
    text = calibrated_text(calibration, provenance)
    fingerprint = parse_device(text, f"{name}.toml").fingerprint
    return {
        f"{name}.toml": text.encode(),
        data_name: raw,
        "report.json": json.dumps({**report, **provenance, "fingerprint": fingerprint}, indent=2).encode(),
        "report.md": report_markdown(report).encode(),
        "fit.png": calibration_png(calibration),
    }
