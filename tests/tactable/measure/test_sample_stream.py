"""Samples through a pipe: what a program declares and writes is what a measurement gets."""

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tactable.measure.sensor import SampleStream, SensorError, SensorForm, read_header, write_header
from tests.engine.loop.rig import DEVICE

FORM = SensorForm(8_000.0, ("acceleration", "loopback left"), (20.0, float("inf")), is_simulated=True)


def test_a_declared_form_is_read_as_it_was_written() -> None:
    form, scale = read_header(write_header(FORM).strip(), DEVICE, "here")
    assert form == FORM
    assert scale.tolist() == [1.0, 1.0]


def test_samples_come_in_declared_units_however_they_were_cut() -> None:
    reader, writer = os.pipe()
    header = {
        "tactable_samples": 1,
        "sample_rate": "8 kHz",
        "channels": [
            {"name": "acceleration", "scale": "1 g_0", "clips_at": 2},
            {"name": "loopback right", "scale": "50 %"},
        ],
    }
    sent = np.arange(24, dtype="<f4").reshape(12, 2)
    data = json.dumps(header).encode() + b"\n" + sent.tobytes()
    os.write(writer, data[:-37])
    stream = SampleStream(Path(f"/proc/self/fd/{reader}"), DEVICE)
    os.close(reader)
    assert stream.form.sample_rate_hz == 8000
    assert stream.form.clips_at == (2 * 9.80665, float("inf"))
    found: list[Any] = []
    for later in (b"", data[-37:-3], data[-3:]):
        os.write(writer, later)
        block = stream.read()
        found += [] if block is None else [block.values]
    np.testing.assert_allclose(np.concatenate(found), sent * [9.80665, 0.5])
    os.close(writer)
    with pytest.raises(SensorError, match="the samples have ended"):
        stream.read()
    stream.close()


@pytest.mark.parametrize(
    ("changed", "text"),
    [
        ({"sample_rate": "8 m"}, "sample_rate: '8 m' is a length; expected a frequency"),
        ({"sample_rate": "0 Hz"}, "expected more than 0"),
        ({"rate": 8000}, "rate: 8000: unknown key; known keys are sample_rate"),
        ({"channels": []}, "expected a list of objects"),
        ({"channels": [{"name": "loopback left", "scale": "100 %"}]}, "no channel named 'acceleration'"),
        (
            {"channels": [{"name": "accel", "scale": "1 m/s^2"}]},
            "name: 'accel': expected one of acceleration",
        ),
        ({"channels": [{"name": "acceleration", "scale": "1 m/s"}]}, "is a speed; expected an acceleration"),
        ({"tactable_samples": 2}, "declare the samples"),
    ],
)
def test_a_header_that_is_none_is_refused_by_name(changed: dict[str, Any], text: str) -> None:
    header = json.loads(write_header(FORM)) | changed
    with pytest.raises(SensorError, match=text):
        read_header(json.dumps(header).encode(), DEVICE, "here")


def test_a_file_of_something_else_is_refused(tmp_path: Path) -> None:
    (tmp_path / "no").write_bytes(b"position (mm)\n1\n")
    with pytest.raises(SensorError, match="does not begin with"):
        SampleStream(tmp_path / "no", DEVICE)
    with pytest.raises(SensorError, match="name a file or pipe"):
        SampleStream(tmp_path / "missing", DEVICE)
