"""A place for compiled kernels: where numba finds none that it may write to, it would refuse to compile at all.

numba keeps compiled kernels beside the sources, or else in the user's cache folder. In a read-only installation whose
user has no writable home, every import of a kernel ends in "cannot cache function". Then a temporary folder stands in:
kernels are compiled once for this command and the processes that it starts, and go with it.
"""

import atexit
import os
import shutil
import tempfile
from pathlib import Path

_VARIABLE = "NUMBA_CACHE_DIR"
_PACKAGE = Path(__file__).parents[2] / "precompute"


def provide_kernel_cache(package: Path = _PACKAGE, home: Path | None = None) -> str | None:
    """Set NUMBA_CACHE_DIR to a temporary folder where numba could not write; a sentence that says so, or None.

    package: a folder with kernels; home: the user's cache folder, by default as numba finds it.
    """
    if os.environ.get(_VARIABLE):
        return None
    user = home or Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    if _is_writable(package / "__pycache__") or _is_writable(user / "numba"):
        return None
    folder = tempfile.mkdtemp(prefix="tactable-kernels-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    os.environ[_VARIABLE] = folder
    return (
        f"compiled kernels are not kept: neither {package} nor {user} is writable; each command compiles them again. "
        f"Set {_VARIABLE} to a folder that is"
    )


def _is_writable(folder: Path) -> bool:
    """Whether a file can be made in a folder, which is made if need be: permissions do not tell of read-only disks."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False
