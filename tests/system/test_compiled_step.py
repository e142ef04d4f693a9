"""The compiled step under the sanitizers of addresses and of undefined behaviour: nothing is reported."""

import subprocess
import sys
from pathlib import Path

import pytest

from engine.loop.fast.fast_layout import c_header
from engine.loop.fast.library import SOURCE
from tests.firmware_link.firmware.compiled_core import need, under_sanitizers

pytestmark = pytest.mark.machine(stall_s=None)

ROOT = Path(__file__).parents[2]
FAST = "tests/engine/loop/fast"
SANITIZED = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all")
# What nothing was written to has a value that shows.
FLAGS = (
    "-O1",
    "-g",
    "-std=c11",
    "-ffp-contract=off",
    "-shared",
    "-fPIC",
    "-ftrivial-auto-var-init=pattern",
    *SANITIZED,
)


def run_under_sanitizers(source: Path, folder: Path) -> "subprocess.CompletedProcess[str]":
    """The tests of the compiled step with a library made of `source`."""
    (folder / "layout.h").write_text(c_header(), encoding="ascii")
    library = folder / "step.so"
    subprocess.run(["cc", *FLAGS, f"-I{folder}", "-o", str(library), str(source), "-lm"], check=True)
    environment = under_sanitizers() | {"TACTABLE_STEP_LIBRARY": str(library)}
    tests = [f"{FAST}/test_step.py", f"{FAST}/test_fast_path.py"]
    command = [sys.executable, "-m", "pytest", "-n", "0", "-x", "-s", "-p", "no:cacheprovider", *tests]
    return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)


def test_the_compiled_step_does_nothing_undefined_and_one_that_reads_beyond_its_memory_is_found(tmp_path: Path) -> None:
    need("cc")
    done = run_under_sanitizers(SOURCE, tmp_path)
    assert done.returncode == 0, done.stdout[-4_000:] + done.stderr[-4_000:]
    assert " passed" in done.stdout

    text = SOURCE.read_text(encoding="utf-8")
    faulty = text.replace("for (int i = 0; i < fast->plans; i++)", "for (int i = 0; i <= MOST_PLANS; i++)")
    assert faulty != text
    (tmp_path / "faulty.c").write_text(faulty, encoding="utf-8")
    done = run_under_sanitizers(tmp_path / "faulty.c", tmp_path)
    assert done.returncode != 0
    assert "runtime error: index 8 out of bounds" in done.stderr + done.stdout
