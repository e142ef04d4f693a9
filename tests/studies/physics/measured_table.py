"""How far a table from measured responses is from the model's, where the model gave the responses.

python -m tests.studies.physics.measured_table STEP_HZ PLACES
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

from engine.table import Table
from engine.table.table_diff import Tolerance, compare_tables
from precompute.builder.table_build import build_table
from precompute.measurements.csv import write_csv
from precompute.measurements.response_table import read_responses
from tests.precompute.devices import shipped
from tests.precompute.measured import SENSOR_MASS_KG
from tests.precompute.measurements.test_response_table import rows


def main() -> None:
    """Print how many figures of reference-a's best rows are off by more than 0.1 dB, and the greatest."""
    step_hz, places = float(sys.argv[1]), int(sys.argv[2])
    device = shipped("reference-a")
    sweep = device.sweep
    frequency_hz = np.arange(sweep.start_hz, sweep.stop_hz + step_hz / 2, step_hz)
    with tempfile.TemporaryDirectory() as name:
        file, modelled, measured = (Path(name, part) for part in ("bar.csv", "modelled.nc", "measured.nc"))
        file.write_text(
            write_csv(rows(device, frequency_hz, places, SENSOR_MASS_KG), device, "SIMULATED"), encoding="utf-8"
        )
        build_table(device, modelled, created="", clicks_up_to=0)
        build_table(device, measured, created="", clicks_up_to=0, responses=read_responses(file, device))
        with Table.open(modelled) as own, Table.open(measured) as other:
            found = compare_tables(own, other, Tolerance(0.1)).best_rows
    print(f"{places} places, every {step_hz:g} Hz: {len(found.changed)} of {found.compared} best rows differ")
    for count, _, figure in found.largest():
        print(f"{figure.figure}: {count} beyond the tolerance, up to {figure.size:.2f} {figure.unit}")


if __name__ == "__main__":
    main()
