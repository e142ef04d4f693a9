"""Octave opens a table as docs/tables.md says, and finds the numbers of a figure."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from tactable import Device, build_table
from tests.documents import ROOT, Page, read_blocks
from tests.small_device import small_text

pytestmark = [
    pytest.mark.machine(stall_s=None),
    pytest.mark.skipif(
        shutil.which("octave-cli") is None, reason="there is no octave-cli: run tests/system/prepare.sh on Debian"
    ),
]


def test_octave_finds_the_numbers_of_the_figure_and_says_what_the_page_says_of_python(tmp_path: Path) -> None:
    (tmp_path / "my-bar.toml").write_text(small_text(), encoding="utf-8")
    build_table(Device.read(tmp_path / "my-bar.toml"), tmp_path / "my-bar.nc", clicks_up_to=1)
    with pytest.MonkeyPatch.context() as monkeypatch, Page(tmp_path) as page:
        monkeypatch.chdir(tmp_path)
        blocks = read_blocks(ROOT / "docs" / "tables.md")
        for block in (block for block in blocks if block.language == "console"):
            page.run(block)
        script = "\n".join(block.text for block in blocks if block.language == "octave")
        done = subprocess.run(["octave-cli", "-q", "--eval", script], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    drawn = np.genfromtxt(tmp_path / "factor.csv", delimiter=",", skip_header=1)
    found = np.genfromtxt(tmp_path / "octave.csv", delimiter=",")
    assert len(found) == 61 * 61
    np.testing.assert_allclose(found, drawn, rtol=0, atol=1e-6)
    assert done.stdout.splitlines() == ["0.980 at 88 and 88 Hz", "121 samples, greatest 1.00 of full scale"]
