"""Places for what is compiled and kept: none that other users can write, and one for kernels wherever numba has none.

Kept code runs as the user that loads it, so a stated folder that others can change is not used (`base.trust`).

numba keeps compiled kernels beside the sources, or else in the user's cache folder. In a read-only installation whose
user has no writable home, every import of a kernel ends in "cannot cache function". Then a temporary folder stands in:
kernels are compiled once for this command and the processes that it starts, and go with it.
"""

import atexit
import contextlib
import os
import tempfile
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path

from base.files import work_folder
from base.trust import REMEDY, open_to_others

_VARIABLE = "NUMBA_CACHE_DIR"
_PACKAGE = Path(__file__).parents[1] / "precompute"


def refuse_open_caches() -> Iterator[str]:
    """Forget the stated cache folders that other users can change; a sentence for each."""
    for variable in (_VARIABLE, "XDG_CACHE_HOME"):
        if (stated := os.environ.get(variable)) and (part := open_to_others(Path(stated))) is not None:
            del os.environ[variable]  # for child processes, too
            yield f"{variable}={stated} is not used, since code is loaded from there: {REMEDY.format(part)}"


def provide_kernel_cache(package: Path = _PACKAGE, home: Path | None = None) -> str | None:
    """Set NUMBA_CACHE_DIR to a temporary folder where numba could not write; a sentence that says so, or None.

    A stated folder counts as one that others cannot change (`refuse_open_caches`).
    package: a folder with kernels; home: the user's cache folder, by default as numba finds it.
    """
    if os.environ.get(_VARIABLE):
        return None
    user = home or Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    if _is_writable(package / "__pycache__") or (_is_writable(user / "numba") and not open_to_others(user / "numba")):
        return None
    made = contextlib.ExitStack()
    atexit.register(made.close)
    try:
        os.environ[_VARIABLE] = str(made.enter_context(work_folder("kernels")))
    except OSError as error:  # commands that need no kernel, such as `list`, go on
        return f"kernels cannot be compiled: {error}: set {_VARIABLE} and TMPDIR to folders writable by you alone"
    return (
        f"compiled kernels are not kept: neither {package} nor {user} is writable by you alone; each command "
        f"compiles them again. Set {_VARIABLE} to a folder that is"
    )


def compile_steady_solver(on_compile: Callable[[str], None]) -> None:
    """Compile the kernels of steady drives where no earlier command has; `on_compile` is told when that begins.

    A build compiles at its end and a run at its start, so that neither a run nor a touch waits without a word.
    """
    from numba.core.event import Listener, install_listener  # a run that is refused does not wait for it

    class Told(Listener):
        is_told = False

        def on_start(self, _event: object) -> None:
            if not self.is_told:
                self.is_told = True
                on_compile("compiling the solver of steady drives, once on this machine: about half a minute")

        def on_end(self, _event: object) -> None:
            pass

    with install_listener("numba:compile", Told()):
        import_module("engine.steady.steady_solver")


def _is_writable(folder: Path) -> bool:
    """Whether a file can be made in a folder, which is made if need be: permissions do not tell of read-only disks."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False
