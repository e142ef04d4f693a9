"""Compiled kernels give the same digits whether they were compiled in this process or loaded from the cache."""

import ast
from pathlib import Path

from precompute.model.band_solver import solve_banded
from precompute.model.gram import fill_gram
from precompute.sweep.sweep_kernels import fill_coherent_sweep, fill_pair_sweep

ROOT = Path(__file__).parents[2]


def test_reordering_kernels_that_others_call_are_inlined() -> None:
    """Of a fast-math function that is called, a first process may run another copy than the one that goes to the cache.

    The two are optimised apart, and where operations may be fused or reordered their last digits differ.
    """
    kernels, called = dict[str, set[str]](), set[str]()
    for path in (ROOT / "precompute").rglob("*.py"):
        for function in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            options = _options_of(function) if isinstance(function, ast.FunctionDef) else None
            if isinstance(function, ast.FunctionDef) and options is not None:
                kernels[function.name] = options
                calls = [call.func for call in ast.walk(function) if isinstance(call, ast.Call)]
                called |= {name.id for name in calls if isinstance(name, ast.Name)}
    reordering = {name for name, options in kernels.items() if "fastmath" in options}
    assert len(reordering) > 5 and reordering & called
    assert {name for name in reordering & called if "inline" not in kernels[name]} == set()


def test_parallel_kernels_neither_fuse_nor_reorder() -> None:
    """Their loop is a function of its own, of which a process that loads the kernel compiles another copy."""
    kernels = fill_pair_sweep, fill_coherent_sweep, fill_gram, solve_banded
    assert {kernel.__name__ for kernel in kernels} == _parallel_kernels()
    for kernel in kernels:
        assert set(kernel.targetoptions.get("fastmath", ())) <= {"nnan", "ninf", "nsz"}


def _parallel_kernels() -> set[str]:
    """Names of the kernels whose loops run on several processors."""
    paths = (*(ROOT / "precompute").rglob("*.py"), *(ROOT / "engine").rglob("*.py"))
    nodes = (node for path in paths for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
    functions = (node for node in nodes if isinstance(node, ast.FunctionDef))
    return {function.name for function in functions if "parallel" in (_options_of(function) or ())}


def _options_of(function: ast.FunctionDef) -> set[str] | None:
    """Names of the options of a function's `njit`; None where it is not compiled."""
    for decorator in function.decorator_list:
        if isinstance(decorator, ast.Call) and ast.unparse(decorator.func) == "njit":
            return {str(keyword.arg) for keyword in decorator.keywords}
    return None
