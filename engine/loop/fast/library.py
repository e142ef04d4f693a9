"""The compiled step as a library: compiled on the spot where there is a C compiler, and loaded.

Whoever can write the library can run code as its user. So it is loaded only from a folder and a file that belong to the
user and that nobody else can write, and only if it ends in the SHA-256 of what the compiler made; loaders ignore what
follows a library. Otherwise it is compiled anew.
"""

import ctypes
import hashlib
import os
import shutil
import stat
import subprocess
import sys
import zlib
from pathlib import Path

from engine.files import partial_path, remove_partials
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
        if not _is_trusted(path):
            _compile(path)
    except OSError as error:
        raise FastPathError(f"{path} cannot be made: {error}; delete it") from error
    return open_fast_path(path)


def open_fast_path(path: Path) -> ctypes.CDLL:
    """A library that was made from `step.c`. Raises FastPathError for another one."""
    try:
        library = ctypes.CDLL(str(path))
        library.fast_wait.argtypes = (ctypes.c_void_p, ctypes.c_int64)
        library.fast_wait.restype = library.fast_answer.restype = ctypes.c_int64
        library.fast_answer.argtypes = (ctypes.c_void_p,)
        library.fast_set_time.argtypes = (ctypes.c_int64,)
        library.fast_start()
    except (OSError, AttributeError) as error:  # AttributeError: it has no such symbol
        raise FastPathError(f"{path} cannot be opened: {error}; delete it") from error
    return library


def _is_trusted(path: Path) -> bool:
    """Whether only this user can have written the library, and it is whole."""
    try:
        folder, file = path.parent.stat(), path.lstat()
        content = path.read_bytes() if stat.S_ISREG(file.st_mode) else b""
    except OSError:
        return False
    is_private = folder.st_uid == file.st_uid == os.getuid() and not (folder.st_mode & 0o077 or file.st_mode & 0o022)
    size = hashlib.sha256().digest_size
    return is_private and len(content) > size and hashlib.sha256(content[:-size]).digest() == content[-size:]


def _compile(path: Path) -> None:
    compiler = next(filter(None, map(shutil.which, _COMPILERS)), None)
    if compiler is None:
        raise FastPathError("no C compiler: install one (gcc) and commands leave some 20 us sooner")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.parent.chmod(0o700)  # an OSError where it is somebody else's
    remove_partials(path)
    folder = partial_path(path)
    folder.mkdir()
    try:
        made = folder / path.name
        (folder / "layout.h").write_text(c_header(), encoding="ascii")
        command = [compiler, *_FLAGS, f"-I{folder}", "-o", str(made), str(SOURCE), "-lm"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise FastPathError(f"{compiler} does not compile {SOURCE.name}: {done.stderr.strip()[-500:]}")
        content = made.read_bytes()
        made.write_bytes(content + hashlib.sha256(content).digest())
        made.chmod(0o700)
        made.replace(path)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
