"""The compiled step as a library: compiled on the spot where there is a C compiler (`base.c_library`), and loaded."""

import ctypes
import sys
from pathlib import Path

from base.c_library import CompileError, LibrarySource, compile_library
from base.errors import TactableError
from engine.loop.fast.fast_layout import c_header

SOURCE = Path(__file__).with_name("step.c")
# Without contraction: a product and a sum in one step would round otherwise than Python does.
_FLAGS = ("-O2", "-std=c11", "-ffp-contract=off", "-shared", "-fPIC")


class FastPathError(TactableError):
    """There is no compiled step here: why, and what would give one."""


def compile_fast_path(folder: Path) -> ctypes.CDLL:
    """The library in `folder`, compiled there unless it is there already. Raises FastPathError."""
    if sys.byteorder != "little":
        raise FastPathError("this machine is big-endian: its reports are answered by the Python loop")
    source = LibrarySource("fast_path", (SOURCE,), _FLAGS, {"layout.h": c_header()})
    try:
        path = compile_library(folder, source)
    except CompileError as error:
        raise FastPathError(f"{error}; commands then leave some 20 us sooner") from error
    return open_fast_path(path)


def open_fast_path(path: Path) -> ctypes.CDLL:
    """A library that was made from `step.c`. Raises FastPathError for another one."""
    try:
        library = ctypes.CDLL(str(path))
        library.fast_wait.argtypes = (ctypes.c_void_p, ctypes.c_int64)
        library.fast_wait.restype, library.fast_answer.restype = None, ctypes.c_int64
        library.fast_answer.argtypes = (ctypes.c_void_p,)
        library.fast_set_time.argtypes = (ctypes.c_int64,)
        library.fast_start()
    except (OSError, AttributeError) as error:  # AttributeError: it has no such symbol
        raise FastPathError(f"{path} cannot be opened: {error}; delete it") from error
    return library
