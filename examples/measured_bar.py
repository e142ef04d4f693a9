"""A measured bar to its table: fit the description to readings of an accelerometer, then build from the fit.

python examples/measured_bar.py
"""

from pathlib import Path
from tempfile import TemporaryDirectory

from tactable import Table, build_table, calibrate, calibrated_device, find_device, quantity_text, read_measurements

described = find_device("reference-a").with_values({"sweep.step": "4 Hz"})
# Shipped readings, SIMULATED: 22 places, six drives. `tactable measure` records those of a real bar.
readings = read_measurements("tables/measurements/reference-a-drifted.csv", described)
found = calibrate(described, readings)
print(f"{len(readings)} readings, noise {100 * found.noise:.1f} %, {found.is_wrong.sum()} taken for wrong")
for each in found.estimates:
    low, value, high = (quantity_text(number, each.parameter.unit, 4) for number in (each.low, each.value, each.high))
    print(f"{each.parameter.name}: {value}, 95 % from {low} to {high}")

calibrated = calibrated_device(found)  # a device file: calibrated.text
with TemporaryDirectory() as folder:
    path = Path(folder) / "calibrated.nc"
    build_table(calibrated, path, clicks_up_to=0)
    with Table.open(path, device=calibrated) as table:
        print(table.drive_for(felt=["35 mm"], quiet=["120 mm"]))
