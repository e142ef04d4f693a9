"""Arrays of a MAT file from another program, read by SciPy in a child process with bounded time.

On some damaged files SciPy reads beyond its memory, which Python cannot survive. So a child process reads the file: it
may take LIMIT_S of processor time, and however it ends, this process only gets a refusal. Arrays come back as .npy data
in anonymous memory, which can hold no code.
"""

import math
import os
import resource
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from base.child import Child, ChildError, Parent
from precompute.measurements.columns import SIMULATED
from precompute.measurements.sheet import MOST_ROWS
from precompute.measurements.types import MeasurementError

LIMIT_S = 20  # processor time of the child, with its start: some hundred times what a file of a thousand readings takes
_LONGEST_S = 300.0  # the longest that reading may take by the clock, even on a machine that much other work keeps busy
_NUMBERS = "double", "single", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))
_MOST_NUMBERS = 10 * MOST_ROWS


class Content(NamedTuple):
    """The numeric arrays of a file by name, and whether any text of it says SIMULATED."""

    arrays: Mapping[str, NDArray[Any]]
    is_simulated: bool


def read_content(path: Path, limit_s: int = LIMIT_S) -> Content:
    """Read a file in a child process that may take `limit_s` of processor time. Raises MeasurementError."""
    memory = os.memfd_create("measurements")
    with os.fdopen(memory, "r+b") as arrays:
        arguments = {"path": str(path), "arrays": memory, "limit_s": limit_s}
        with Child(__name__, arguments, name="its reader", descriptors=[memory]) as child:
            try:
                said = child.read(_LONGEST_S)
            except ChildError as error:
                raise MeasurementError(f"{path}: is damaged: {error}; export it again") from None
            finally:
                child.kill()  # it has nothing to finish, and may never end
        if "refused" in said:
            raise MeasurementError(said["refused"])
        return Content({name: np.load(arrays, allow_pickle=False) for name in said["names"]}, said["is_simulated"])


def main(parent: Parent, arguments: dict[str, Any]) -> None:
    """The child: says what the file holds or why it is refused, and writes the arrays into the memory it was given."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CPU, (arguments["limit_s"],) * 2)
    try:
        content = load_content(Path(arguments["path"]))
    except MeasurementError as error:
        parent.say({"refused": str(error)})
        return
    with os.fdopen(arguments["arrays"], "r+b") as arrays:
        for values in content.arrays.values():
            np.save(arrays, values, allow_pickle=False)
        arrays.flush()
        arrays.seek(0)  # the parent reads at the same place
    parent.say({"names": list(content.arrays), "is_simulated": content.is_simulated})


def load_content(path: Path) -> Content:
    """Read a file in this process; raises MeasurementError. What SciPy makes of a damaged file is unknown."""
    import scipy.io

    with path.open("rb") as file:
        if file.read(10) == b"MATLAB 7.3":
            raise MeasurementError(f"{path}: is a MAT file of version 7.3, HDF5; save it with save(..., '-v7')")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # such as for a duplicate name
            kinds = scipy.io.whosmat(str(path), appendmat=False)
            wrong = [f"{name} is a {kind}" for name, _, kind in kinds if kind not in (*_NUMBERS, "char")]
            if not wrong and sum(math.prod(shape) for _, shape, _ in kinds) <= _MOST_NUMBERS:
                content = scipy.io.loadmat(str(path), appendmat=False)
            else:
                what = wrong[0] if wrong else f"has more than {_MOST_NUMBERS} numbers"
                raise MeasurementError(f"{path}: {what}; save the responses alone, as arrays")
    except MeasurementError:
        raise
    except Exception as error:  # scipy raises many of Python's on malformed files
        remedy = "save it with save(..., '-v7')"
        raise MeasurementError(f"{path}: cannot be read as a MAT file of version 5 ({error}); {remedy}") from error
    texts = [str(content[name]) for name, _, kind in kinds if kind == "char"]
    arrays = {name: np.atleast_2d(content[name]) for name, _, kind in kinds if kind != "char"}
    return Content(arrays, any(SIMULATED in text for text in texts))
