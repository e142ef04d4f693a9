"""Compiles C files into shared libraries in a cache folder, and loads only those that no other user can have written.

A library is loaded only from where nobody else can have written it (`base.trust`), and only if it ends in the
SHA-256 of what the compiler made; loaders ignore what follows a library. Otherwise it is compiled anew.
"""

import hashlib
import shutil
import stat
import subprocess
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from base.errors import TactableError
from base.files import partial_path, remove_partials
from base.trust import REMEDY, open_to_others

_COMPILERS = ("cc", "gcc", "clang")


class CompileError(TactableError):
    """A library cannot be compiled here: why, and what would help."""


@dataclass(frozen=True)
class LibrarySource:
    """What a library is made of. headers: text by name of those that are generated; include: folders of the others."""

    name: str
    sources: Sequence[Path]
    flags: Sequence[str]
    headers: Mapping[str, str] = field(default_factory=dict)
    include: Sequence[Path] = ()

    def fingerprint(self) -> int:
        """CRC-32 of everything that the library is made of."""
        files = [*self.sources, *(path for folder in self.include for path in sorted(folder.glob("*.h")))]
        parts = [*(path.read_bytes() for path in files), *map(str.encode, self.headers.values())]
        return zlib.crc32(b"".join(parts) + " ".join(self.flags).encode())


def compile_library(folder: Path, source: LibrarySource) -> Path:
    """The path of the library in `folder`, compiled there unless it is there already. Raises CompileError."""
    path = folder / f"{source.name}-{source.fingerprint():08x}.so"
    try:
        if not _is_whole(path):
            _compile(path, source)
    except OSError as error:
        raise CompileError(f"{path} cannot be made: {error}; delete it") from error
    return path


def _is_whole(path: Path) -> bool:
    """Whether the library is a plain file that only this user can have written, as the compiler made it."""
    try:
        if open_to_others(path) is not None or not stat.S_ISREG(path.lstat().st_mode):
            return False
        content = path.read_bytes()
    except OSError:
        return False
    size = hashlib.sha256().digest_size
    return len(content) > size and hashlib.sha256(content[:-size]).digest() == content[-size:]


def find_compiler() -> str | None:
    """Path of the system's C compiler, or None on a system without one."""
    return next(filter(None, map(shutil.which, _COMPILERS)), None)


def _compile(path: Path, source: LibrarySource) -> None:
    compiler = find_compiler()
    if compiler is None:
        raise CompileError("no C compiler: install one (gcc)")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.parent.chmod(0o700)  # an OSError where it is somebody else's
    if (part := open_to_others(path.parent)) is not None:
        raise CompileError(f"{path.parent} keeps no library: {REMEDY.format(part)}")
    remove_partials(path)
    folder = partial_path(path)
    folder.mkdir()
    try:
        made = folder / path.name
        for name, text in source.headers.items():
            (folder / name).write_text(text, encoding="ascii")
        include = [f"-I{each}" for each in (folder, *source.include)]
        command = [compiler, *source.flags, *include, "-o", str(made), *map(str, source.sources), "-lm"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            names = ", ".join(each.name for each in source.sources)
            raise CompileError(f"{compiler} does not compile {names}: {done.stderr.strip()[-500:]}")
        content = made.read_bytes()
        made.write_bytes(content + hashlib.sha256(content).digest())
        made.chmod(0o700)
        made.replace(path)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
