"""Kernels whose kept machine code is used only while everything that went into it is unchanged.

numba keeps the machine code of a kernel with `cache=True`, and uses it again while the kernel's own file has the same
time and size. But the code of other kernels that it calls is in it too, and so are the values of constants that were
imported: after a change of those, such as an update of a checkout, old numbers would come from new sources without a
word. Here the kept code counts by contents, the kernel's own and those of all that it calls; and only from where nobody
else can have put it (`base.trust`).
"""

import contextlib
import hashlib
import warnings
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

import numba
import numpy as np
from numba.core.caching import FunctionCache
from numba.core.dispatcher import Dispatcher
from numba.core.typeinfer import register_dispatcher

from base.trust import REMEDY, open_to_others


def njit(*signature: Any, cache: bool = False, **options: Any) -> Callable[[Callable[..., Any]], Any]:
    """As `numba.njit` with the same arguments, but code kept by `cache=True` counts by contents."""

    def decorate(function: Callable[..., Any]) -> Any:
        dispatcher = numba.njit(**options)(function)
        if dispatcher is function:  # NUMBA_DISABLE_JIT
            return function
        if cache:
            kept: Any = _KeptCode
            dispatcher._cache = kept(function)  # what enable_caching() does; numba takes no cache from outside
        if signature:
            with register_dispatcher(dispatcher):
                dispatcher.compile(*signature)
            dispatcher.disable_compile()
        return dispatcher

    return decorate


def contents_of(function: FunctionType) -> str:
    """SHA-256 (hex) of the files of a kernel and of all kernels that it calls, and of the constants that these take."""
    digest = hashlib.sha256()
    for part in _parts_of(function, set()):
        digest.update(part)
        digest.update(b"\0")
    return digest.hexdigest()


def _parts_of(function: FunctionType, done: set[FunctionType]) -> Iterator[bytes]:
    """The contents of a kernel's file, then its constants, then the parts of what it calls, each once."""
    done.add(function)
    yield _read(function.__code__.co_filename)
    for name in sorted(set(_names_in(function.__code__))):
        value = function.__globals__.get(name)
        if isinstance(value, Dispatcher) and value.py_func not in done:
            yield from _parts_of(value.py_func, done)
        elif isinstance(value, int | float | complex | str | tuple | np.generic | np.ndarray):
            yield f"{name}={value.tolist() if isinstance(value, np.ndarray) else value!r}".encode()


def _names_in(code: CodeType) -> Iterator[str]:
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, CodeType):  # of a function within
            yield from _names_in(constant)


@cache
def _read(path: str) -> bytes:
    return Path(path).read_bytes()


def _checked(locator: type[Any]) -> type[Any]:
    """A class that tells numba where to keep machine code: nowhere that others can write; sources count by contents.

    Kept code is unpickled, so whoever can write the file runs code as its reader. Code that lies beside the sources is
    trusted as they are.
    """

    class Checked(locator):  # type: ignore[misc]  # numba has no types
        @classmethod
        def from_function(cls, py_func: FunctionType, py_file: str) -> Any:
            found = super().from_function(py_func, py_file)
            if found is None:
                return None
            folder = Path(found.get_cache_path())
            if folder.parent != Path(py_file).parent and (part := open_to_others(folder)) is not None:
                warnings.warn(f"compiled kernels are not kept in {folder}: {REMEDY.format(part)}", stacklevel=1)
                return None
            found.contents = None
            with contextlib.suppress(OSError):  # from an archive: numba looks at the time of that
                found.contents = contents_of(py_func)
            return found

        def get_source_stamp(self) -> Any:
            return super().get_source_stamp() if self.contents is None else self.contents

    return Checked


_NUMBA_FILES: Any = FunctionCache._impl_class  # numba has no public name for it


class _KeptCodeFiles(_NUMBA_FILES):  # type: ignore[misc]  # Any, as numba's part is
    """Reads and writes kept code as numba does, but only where `_checked` locators find a place for it."""

    _locator_classes = tuple(map(_checked, _NUMBA_FILES._locator_classes))


class _KeptCode(FunctionCache):
    """The kept code of one kernel of this project; kernels of other packages in the process keep numba's own."""

    _impl_class = _KeptCodeFiles
