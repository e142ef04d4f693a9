"""A sweep and its best row: the published method, looked up in a table of localized factors.

python examples/best_row.py
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from tactable import Table, build_table, find_device

bar = find_device("reference-a").with_values({"sweep.step": "4 Hz"})  # coarse: a few seconds
with TemporaryDirectory() as folder:
    path = Path(folder) / "bar.nc"
    build_table(bar, path, clicks_up_to=0)
    with Table.open(path, device=bar) as table:
        # Share of the kinetic energy in zones I and III: (frequency_1, frequency_2, amplitude_1, amplitude_2).
        factor = table.localized_factor(["I", "III"])
        peak_m_per_s2 = table.peak_acceleration(["I", "III"])
        row = np.unravel_index(np.nanargmax(factor), factor.shape)
        first_hz, second_hz = bar.sweep.frequency_hz[[row[0], row[1]]]
        print(
            f"greatest factor {factor[row]:.3f} at {first_hz:.0f} and {second_hz:.0f} Hz: {peak_m_per_s2[row]:.2f} m/s²"
        )

        # What a run in zones mode plays: the greatest factor among the rows that reach the level in every wanted zone.
        best = table.best_row(["I", "III"], level_db=20)
        outputs = zip(best.frequencies_hz, best.amplitudes, strict=True)
        drive = ", ".join(f"{hz:.0f} Hz at {100 * amplitude:.0f} %" for hz, amplitude in outputs)
        print(f"for 20 dB: factor {best.localized_factor:.3f}, {drive}; limited by {best.limited_by}")
