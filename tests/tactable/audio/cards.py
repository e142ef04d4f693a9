"""Sound cards for the tests: the library of the C core, and a port in virtual time."""

import ctypes
import functools
import tempfile
from pathlib import Path

import pytest

from tactable.audio.board import core_library
from tactable.audio.names import AudioError, AudioOutput, parse_output
from tests.tools.guard import allowed

TEXT = "audio:simulated,full_scale=0.52 um,most=80 %"
OUTPUT: AudioOutput = parse_output(TEXT)


@functools.cache
def core() -> ctypes.CDLL:
    """The C core, compiled once for a process of tests; skips by name without a compiler."""
    with tempfile.TemporaryDirectory() as folder, allowed("compiles the C core"):
        try:
            return core_library(Path(folder) / "cache")
        except AudioError as error:
            pytest.skip(str(error))
