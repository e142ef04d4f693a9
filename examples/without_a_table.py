"""A drive and a click without a table: solved in seconds for fingers on a bar, and what a stiffer bar makes of them.

python examples/without_a_table.py
"""

import tactable

felt, quiet = ["35 mm"], ["120 mm"]
device = tactable.find_device("reference-a")
print(f"tactable {tactable.__version__}: {device.name}, levels are dB above: {device.threshold.title}")

drive = tactable.solve_drive(device, felt=felt, quiet=quiet, level_db=20)
print(drive)  # one frequency; an amplitude and a phase for each actuator
print(f"contrast {drive.contrast_db:.1f} dB in the model, {drive.expected_contrast_db:.1f} dB over sampled fingers")

click = tactable.solve_click(device, felt=felt, quiet=quiet)
print(click)  # as strong as it can be, while the other finger feels nothing, for the spread of the device

for thickness in ("0.7 mm", "0.9 mm"):  # a design is another device: nothing is built for it
    bar = device.with_values({"bar.thickness": thickness})
    again = tactable.solve_click(bar, felt=felt, quiet=quiet)
    print(f"{thickness}: felt {again.felt.low_db:.1f} dB (5 % of the plants)")

try:
    tactable.solve_drive(device, felt=felt, level_db="loud")  # type: ignore[arg-type]  # what is wrong is named
except tactable.TactableError as error:
    print("refused:", error)
