"""Compiles the kernels that live play and builds need, once on a machine, and tells which of how many.

Numba compiles a kernel with a declared signature when its module is imported, and keeps it in a cache; later imports
load it in milliseconds. So a process that must not wait imports none of these modules until another has, with this.
Those of clicks come first, since steady drives can do without for a while (`engine.steady.plain`), and no click can.
They have no declared signature: the first click compiles them.
"""

from collections.abc import Callable, Sequence
from importlib import import_module

from engine.device import Device
from engine.table.clicks import Clicks
from tactable.rig.first_table import solve_first_click

STEADY = (
    "engine.steady.forms",
    "engine.steady.optimum",
    "engine.steady.ascent",
    "engine.steady.loading",
    "engine.steady.search",
)
"""What steady drives at any positions take."""
SWEEP = ("precompute.model.band_solver", "precompute.model.gram", "precompute.sweep.kernels")
"""What the rows of a sweep take, which zones play."""
BUILDS = (
    "precompute.sampling.bars",
    "precompute.predict.performance",
    "precompute.predict.rise_time",
)
"""What builds take beside that."""
_FIRST_CLICK = "the first click"
_ALL = (_FIRST_CLICK, *STEADY, *SWEEP, *BUILDS)
OnModule = Callable[[str, int, int], None]
"""Told the name, number and count of what is compiled, before each."""


def compile_for_clicks(on_module: OnModule, device: Device) -> Clicks:
    """The first click of the device, whose solving compiles what clicks take."""
    on_module(_FIRST_CLICK, 1, len(_ALL))
    return solve_first_click(device)


def compile_all(modules: Sequence[str], on_module: OnModule) -> None:
    """Compile the kernels of these modules, of the lists above."""
    for module in modules:
        on_module(module, _ALL.index(module) + 1, len(_ALL))
        import_module(module)
