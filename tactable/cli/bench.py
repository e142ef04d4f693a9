"""Commands `bench ...`: each runs one benchmark, and prints its page or its JSON."""

from tactable.cli.console import show
from tactable.cli.options import AsJson, DeviceOption, Level, TableArgument, read_level
from tactable.shipped import find_device


def sweep(device_name: DeviceOption = "reference-a", as_json: AsJson = False) -> None:
    """Time the sweep over frequencies and amplitudes.

    It is compared with NumPy, with the solution point by point, and with the time to write the same memory.
    """
    from tactable.bench.sweep import print_sweep_bench, run_sweep_bench

    show(run_sweep_bench(find_device(device_name)), as_json, print_sweep_bench)


def states(device_name: DeviceOption = "reference-a", as_json: AsJson = False) -> None:
    """Time the entries of every state, beside a general-purpose solver.

    The solver is SLSQP from random starts on the same problems.
    """
    from tactable.bench.entries import print_states_bench, run_states_bench

    show(run_states_bench(find_device(device_name)), as_json, print_states_bench)


def contrast(
    table_path: TableArgument,
    level: Level = "20",
    as_json: AsJson = False,
) -> None:
    """Compare the paper's objective with ours, SIMULATED.

    Every state of one felt and one quiet finger is computed in frequency and simulated in time.
    """
    from engine.table import Table
    from tactable.bench.entries import print_contrast_bench, run_contrast_bench

    level_db = read_level(level)
    with Table.open(table_path) as table:
        show(run_contrast_bench(table, level_db), as_json, print_contrast_bench)
