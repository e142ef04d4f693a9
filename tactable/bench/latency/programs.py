"""Small C programs that are compiled on the spot."""

import subprocess
from pathlib import Path

from base.c_library import find_compiler


def build_program(name: str, folder: Path) -> Path | None:
    """Compile the C file `name` beside this module into `folder`; None where no compiler is there or none succeeds."""
    compiler, program = find_compiler(), folder / name
    if compiler is None:
        return None
    source = Path(__file__).with_name(f"{name}.c")
    command = [compiler, "-O2", "-std=c11", "-o", str(program), str(source)]
    return program if subprocess.run(command, capture_output=True, check=False).returncode == 0 else None


def exchange_ns(program: Path | None, first: int, second: int) -> int | None:
    """How long a cache line takes from one processor to another and back, ns, by the program `exchange`.

    None without the program, for one processor alone, and where it may not run on both.
    """
    if program is None or first == second:
        return None
    done = subprocess.run([str(program), str(first), str(second)], capture_output=True, text=True, check=False)
    return int(done.stdout) if done.returncode == 0 else None
