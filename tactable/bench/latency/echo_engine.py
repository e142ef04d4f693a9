"""The C echo engine: the cost of the same wake-ups and bytes without an engine, a floor."""

import subprocess
from collections.abc import Collection
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from engine.loop.realtime import PRIORITY, Step


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
