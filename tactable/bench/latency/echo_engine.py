"""The C echo engine, compiled on the spot: the cost of the same wake-ups and bytes without an engine, a floor."""

import shutil
import subprocess
from collections.abc import Collection
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from engine.loop.realtime import PRIORITY, Step

_SOURCE = Path(__file__).with_name("echo_engine.c")
_COMPILERS = ("cc", "gcc", "clang")


def build_echo_engine(folder: Path) -> Path | None:
    """Compile the program into `folder`; None where no compiler is there or none succeeds."""
    compiler = next(filter(None, map(shutil.which, _COMPILERS)), None)
    program = folder / "echo_engine"
    if compiler is None:
        return None
    command = [compiler, "-O2", "-std=c11", "-o", str(program), str(_SOURCE)]
    return program if subprocess.run(command, capture_output=True, check=False).returncode == 0 else None


def start_echo_engine(
    program: Path,
    touch: int,
    link: int,
    every: int,
    size: int,
    samples: Path,
    steps: Collection[Step],
    processor: int,
) -> "subprocess.Popen[bytes]":
    """Run it on two descriptors until `touch` ends, with those of the real-time steps that a C program can take.

    Each of its answers has `size` bytes.
    """
    priority = PRIORITY if Step.PRIORITY in steps else 0
    chosen = processor if Step.AFFINITY in steps else -1
    numbers = (touch, link, every, size, samples, priority, chosen, int(Step.MEMORY in steps))
    return subprocess.Popen([str(program), *map(str, numbers)], pass_fds=(touch, link))


def read_echo_samples(path: Path) -> NDArray[np.int64]:
    """Shape (answer, 4): when each was due, sent, read and written, ns."""
    return np.fromfile(path, np.int64).reshape(-1, 4)
