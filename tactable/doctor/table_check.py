"""Checks whether tables are whole and fresh, and whether compiled code is cached."""

import contextlib
import os
from collections.abc import Iterator, Sequence
from pathlib import Path

from engine.loop.fast.library import FastPathError, compile_fast_path
from engine.table import Table, TableError
from tactable.doctor import Check


def check_tables(paths: Sequence[Path]) -> list[Check]:
    """Checks that each table is whole and was built by the installed code, and what it says of delays of channels."""
    return [check for path in paths for check in (_check_table(path), *_tell_delays(path))]


def _tell_delays(path: Path) -> Iterator[Check]:
    with contextlib.suppress(TableError), Table.open(path) as table:
        late = ", ".join(f"{each.name} {1e6 * each.delay_s:g} us" for each in table.device.actuators)
        yield Check(
            f"delays of channels, {path}",
            f"{late}, as the device file says; 50 us that it does not say take the promise of quiet from 95 to 22 % of "
            "placements (SIMULATED, reference-a): `measure` compares loopbacks, `calibrate` fits `delay`",
        )


def _check_table(path: Path) -> Check:
    from precompute.builder.code_fingerprint import code_fingerprint

    name = f"table {path}"
    try:
        with Table.open(path) as table:
            device, built_by = table.device.name, str(table.attributes.get("code_fingerprint", ""))
    except TableError as error:
        return Check(name, str(error), "build it again: `tactable build DEVICE`")
    if built_by != code_fingerprint():
        remedy = f"build it again: `tactable build {device} -o {path}`"
        return Check(name, f"for {device}, built by another version of the code", remedy, needed=False)
    return Check(name, f"for {device}, whole and fresh")


def check_fast_path(folder: Path) -> Check:
    """Check that the compiled step from a report to its command can be used; compiles it where it is missing."""
    try:
        compile_fast_path(folder)
    except FastPathError as error:
        finding, _, remedy = str(error).partition(": ")
        return Check("fast path", finding, remedy or "run without it", needed=False)
    return Check("fast path", f"compiled in {folder}")


def check_kernels(folder: Path | None = None) -> Check:
    """Check that the compiled kernels of `build` are cached; compiling takes half a minute."""
    where = folder or Path(os.environ.get("NUMBA_CACHE_DIR") or Path(__file__).parents[2] / "precompute")
    kept = len(list(where.rglob("*.nbi"))) if where.is_dir() else 0
    if kept:
        return Check("compiled kernels", f"{kept} are kept in {where}")
    if os.access(where if where.is_dir() else where.parent, os.W_OK):
        return Check("compiled kernels", "none yet: a first build makes them", "run `tactable demo` once", needed=False)
    remedy = "set NUMBA_CACHE_DIR to a folder that you may write to"
    return Check("compiled kernels", f"{where} cannot be written: each build compiles again", remedy, needed=False)
