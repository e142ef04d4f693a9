"""The compiled step as a library: compiled on the spot where there is a C compiler, and loaded."""

import ctypes
import shutil
import subprocess
import sys
import tempfile
import zlib
from pathlib import Path

from engine.loop.fast.layout import c_header
from firmware_link.protocol.errors import TactableError

SOURCE = Path(__file__).with_name("step.c")
_COMPILERS = ("cc", "gcc", "clang")
# Without contraction: a product and a sum in one step would round otherwise than Python does.
_FLAGS = ("-O2", "-std=c11", "-ffp-contract=off", "-shared", "-fPIC")


class FastPathError(TactableError):
    """There is no compiled step here: why, and what would give one."""


def compile_fast_path(folder: Path) -> ctypes.CDLL:
    """The library in `folder`, compiled there unless it is there already. Raises FastPathError."""
    if sys.byteorder != "little":
        raise FastPathError("this machine is big-endian: its reports are answered by the Python loop")
    made_from = SOURCE.read_bytes() + c_header().encode() + " ".join(_FLAGS).encode()
    path = folder / f"fast_path-{zlib.crc32(made_from):08x}.so"
    try:
        if not path.exists():
            _compile(path)
        library = ctypes.CDLL(str(path))
    except OSError as error:
        raise FastPathError(f"{path} cannot be made or opened: {error}") from error
    library.fast_wait.argtypes = (ctypes.c_void_p, ctypes.c_int64)
    library.fast_wait.restype = library.fast_answer.restype = ctypes.c_int64
    library.fast_answer.argtypes = (ctypes.c_void_p,)
    library.fast_set_time.argtypes = (ctypes.c_int64,)
    library.fast_start()
    return library


def _compile(path: Path) -> None:
    compiler = next(filter(None, map(shutil.which, _COMPILERS)), None)
    if compiler is None:
        raise FastPathError("no C compiler: install one (gcc) and commands leave some 20 us sooner")
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        made = Path(folder) / path.name
        (Path(folder) / "layout.h").write_text(c_header(), encoding="ascii")
        command = [compiler, *_FLAGS, f"-I{folder}", "-o", str(made), str(SOURCE), "-lm"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise FastPathError(f"{compiler} does not compile {SOURCE.name}: {done.stderr.strip()[-500:]}")
        made.replace(path)
