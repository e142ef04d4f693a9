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
    pytest.mark.machine,
    pytest.mark.skipif(
        shutil.which("octave-cli") is None, reason="there is no octave-cli: run tests/system/prepare.sh on Debian"
    ),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the page's blocks for the shell and for Octave have run."""
    folder = tmp_path_factory.mktemp("octave")
    (folder / "my-bar.toml").write_text(small_text(), encoding="utf-8")
    build_table(Device.read(folder / "my-bar.toml"), folder / "my-bar.nc", clicks_up_to=1)
    with pytest.MonkeyPatch.context() as monkeypatch, Page(folder) as page:
        monkeypatch.chdir(folder)
        blocks = read_blocks(ROOT / "docs" / "tables.md")
        for block in (block for block in blocks if block.language == "console"):
            page.run(block)
        script = "\n".join(block.text for block in blocks if block.language == "octave")
        done = subprocess.run(["octave-cli", "-q", "--eval", script], capture_output=True, text=True, check=False)
    (folder / "said.txt").write_text(done.stdout, encoding="utf-8")
    assert done.returncode == 0, done.stderr
    return folder


def test_octave_finds_the_numbers_of_the_figure(folder: Path) -> None:
    drawn = np.genfromtxt(folder / "factor.csv", delimiter=",", skip_header=1)
    found = np.genfromtxt(folder / "octave.csv", delimiter=",")
    assert len(found) == 61 * 61
    np.testing.assert_allclose(found, drawn, rtol=0, atol=1e-6)


def test_octave_says_what_the_page_says_of_python(folder: Path) -> None:
    figure, click = (folder / "said.txt").read_text(encoding="utf-8").splitlines()
    assert figure == "0.980 at 88 and 88 Hz"
    assert click == "121 samples, greatest 1.00 of full scale"
