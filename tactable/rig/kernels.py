"""Compiles the kernels that live play and builds need, once on a machine, and tells which of how many.

Numba compiles a kernel with a declared signature when its module is imported, and keeps it in a cache; later imports
load it in milliseconds. So a process that must not wait imports none of these modules until another has, with this.
"""

from collections.abc import Callable
from dataclasses import replace
from importlib import import_module

from engine.device import Device
from engine.touch import Placement

STEADY = (
    "engine.steady.forms",
    "engine.steady.optimum",
    "engine.steady.ascent",
    "engine.steady.loading",
    "engine.steady.search",
)
"""What steady drives at any positions take."""
BUILDS = (
    "precompute.model.band_solver",
    "precompute.model.gram",
    "precompute.sweep.kernels",
    "precompute.sampling.bars",
    "precompute.entries.forms",
    "precompute.entries.bfgs",
    "precompute.entries.scan",
    "precompute.entries.performance",
    "precompute.entries.rise_time",
)
"""What builds take beside that. Kernels of clicks have no declared signature; the first click compiles them."""


def compile_kernels(on_module: Callable[[str, int, int], None], device: Device) -> None:
    """Import the modules, and solve a click of `device`; `on_module` is told name, number and count before each."""
    modules, clicks = (*STEADY, *BUILDS), "precompute.clicks"
    for number, module in enumerate((*modules, clicks), 1):
        on_module(module, number, len(modules) + 1)
        import_module(module)
    from precompute.clicks import DEFAULT_OPTIONS, ClickSolver

    length_m = device.bar.length_m
    ClickSolver(device, replace(DEFAULT_OPTIONS.quick, tolerance_m=1e-3)).solve(Placement.on(device, [0.2 * length_m]))
