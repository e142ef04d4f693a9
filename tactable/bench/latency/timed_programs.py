"""Small C programs that are compiled on the spot: the C echo engine, a floor, and the exchange between processors."""

import subprocess
from collections.abc import Collection
from pathlib import Path

import numpy as np

from base.arrays import Integers
from base.c_library import find_compiler
from engine.loop.realtime import PRIORITY, Step


def build_program(name: str, folder: Path) -> Path | None:
    """Compile the C file `name` beside this module into `folder`; None where no compiler is there or none succeeds."""
    compiler, program = find_compiler(), folder / name
    if compiler is None:
        return None
    command = [compiler, "-O2", "-std=c11", "-o", str(program), str(Path(__file__).with_name(f"{name}.c"))]
    return program if subprocess.run(command, capture_output=True, check=False).returncode == 0 else None


def exchange_ns(program: Path | None, first: int, second: int) -> int | None:
    """How long a cache line takes from one processor to another and back, ns, by the program `exchange`.

    None without the program, for one processor alone, and where it may not run on both.
    """
    if program is None or first == second:
        return None
    done = subprocess.run([str(program), str(first), str(second)], capture_output=True, text=True, check=False)
    return int(done.stdout) if done.returncode == 0 else None


def start_echo_engine(
    program: Path, touch: int, link: int, every: int, size: int, samples: Path, steps: Collection[Step], processor: int
) -> "subprocess.Popen[bytes]":
    """Start the C echo engine on two descriptors, with the real-time steps that a C program can take.

    Each of its answers has `size` bytes.
    """
    priority = PRIORITY if Step.PRIORITY in steps else 0
    chosen = processor if Step.AFFINITY in steps else -1
    numbers = (touch, link, every, size, samples, priority, chosen, int(Step.MEMORY in steps))
    return subprocess.Popen([str(program), *map(str, numbers)], pass_fds=(touch, link))


def read_echo_samples(path: Path) -> Integers:
    """Shape (answer, 4): when each was due, sent, read and written, ns."""
    return np.fromfile(path, np.int64).reshape(-1, 4)
