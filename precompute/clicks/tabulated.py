"""The clicks of a table: one for every placement of one finger, and on a bar of two, at the places of a grid."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import groupby

from engine.device import Device
from engine.table import ClickEntry
from engine.touch.placement import CLOSEST_M, Key, Places
from precompute.clicks.click_options import ClickOptions
from precompute.clicks.click_solver import ClickSolver
from precompute.parallel.pool import WorkerPool

MOST_TABULATED = 2  # more fingers are solved when they come: a coarser grid's clicks are hardly felt
_ROLES = ((0, 1), (1, 0), (1, 1))  # whether each of two fingers feels; one of them does
_TOGETHER = 12  # keys that a process solves in one piece, about: the roles of four pairs of places, which takes 0.1 s
_PAYS = 20  # pieces for which a further process is started: its imports take 1 s
_ROUNDING_M = 1e-9


def most_tabulated(places: Places) -> int:
    """The most fingers whose clicks a table holds: two on a bar, one on a plate, whose pairs of places are too many."""
    return MOST_TABULATED if places.across == 1 else 1


def tabulated_keys(places: Places, fingers: int) -> list[Key]:
    """Keys of the placements of up to `fingers` fingers, in the order of the places, all roles of a pair together.

    Two fingers are at least CLOSEST_M apart, so their places may be up to a pitch closer, but are different ones.
    """
    keys = list[Key]()
    least_m = CLOSEST_M - places.pitch_m - _ROUNDING_M
    for place in range(places.count):
        if fingers >= 1:
            keys.append((2 * place + 1,))
        for other in range(place + 1, places.count if fingers >= MOST_TABULATED else 0):
            if (other - place) * places.pitch_m > least_m:
                keys += [(2 * place + one, 2 * other + another) for one, another in _ROLES]
    return keys


def tabulate_clicks(
    device: Device, options: ClickOptions, places: Places, keys: Sequence[Key], workers: int = 1
) -> Iterator[ClickEntry]:
    """Table rows of the clicks with these keys, in any order.

    This process is one of the `workers` that solve them, and the only one where there are few. Neighbouring keys are
    solved by one process, since the roles of one pair of places share their plants. The result does not depend on the
    number of processes. Raises WorkerError if a process was killed.
    """
    chunks = _chunks(keys)
    if not chunks:
        return
    with WorkerPool(min(workers - 1, len(chunks) // _PAYS)) as pool:
        yield from pool.solve(partial(_begin, device, options, places), chunks, include_self=True)


def _chunks(keys: Sequence[Key]) -> list[list[Key]]:
    """The keys in pieces that a process solves, none of which parts the roles of fingers at the same places."""
    chunks = list[list[Key]]()
    for _, alike in groupby(keys, key=lambda key: [code // 2 for code in key]):
        if not chunks or len(chunks[-1]) >= _TOGETHER:
            chunks.append([])
        chunks[-1] += alike
    return chunks


def _begin(device: Device, options: ClickOptions, places: Places) -> Callable[[Key], ClickEntry]:
    solver = ClickSolver(device, options.at(places, device.spread))
    return lambda key: solver.solve(places.placement(key))
