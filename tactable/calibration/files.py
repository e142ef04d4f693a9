"""A calibration to the files of its folder: device description, raw data, report and picture."""

import hashlib
import json
from typing import Any

from engine.device import Device
from precompute.calibration.calibrate import Calibration
from precompute.calibration.device_text import calibrated_text
from precompute.calibration.report import report_markdown


def calibration_files(
    calibration: Calibration, report: dict[str, Any], raw: bytes, ending: str, created: str
) -> dict[str, bytes]:
    """Contents by name; `raw` is the file of measurements as it was, `ending` such as ".csv"."""
    from tactable.figures.calibration import calibration_png  # a second to import; device_text is in a hurry

    name = calibration.device.name
    text = device_text(calibration, raw, ending, created)
    more = {**_provenance(calibration, raw, ending, created), "fingerprint": Device.parse(text, name).fingerprint}
    return {
        f"{name}.toml": text.encode(),
        _data_name(ending): raw,
        "report.json": json.dumps({**report, **more}, indent=2).encode(),
        "report.md": report_markdown(report).encode(),
        "fit.png": calibration_png(calibration),
    }


def device_text(calibration: Calibration, raw: bytes, ending: str, created: str) -> str:
    """The description among these files."""
    return calibrated_text(calibration, _provenance(calibration, raw, ending, created))


def _provenance(calibration: Calibration, raw: bytes, ending: str, created: str) -> dict[str, str]:
    return {
        "created": created,
        "measurements": _data_name(ending),
        "sha256": hashlib.sha256(raw).hexdigest(),
        "report": "report.json",
        "loss": calibration.loss.value,
    }


def _data_name(ending: str) -> str:
    return f"measurements{ending}"
