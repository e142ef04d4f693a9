"""A click under a finger: what a table holds for these positions, and what it promises over bars and fingers.

tactable build reference-a                       (a minute; `--clicks-up-to 1` for one finger only: seconds)
python examples/click_under_a_finger.py reference-a.nc "35 mm" "120 mm"
"""

import sys

from tactable import Table

path, felt, *quiet = sys.argv[1:]
with Table.open(path) as table:
    click = table.click_for([felt], quiet, level_db=20)
    print(click)  # that of the nearest places in the table
    print("levels are dB above:", table.device.threshold.title)

    found = click.to_xarray()  # waveform (time, actuator), levels by spread over sampled plants
    print("felt:", ", ".join(f"{level:.1f} dB ({spread})" for spread, level in found.felt_level.to_series().items()))
    for name, peak in abs(found.waveform).max("time").to_series().items():
        print(f"{name}: at most {100 * peak:.0f} % of full scale in {click.length_s * 1e3:.0f} ms")

    drive = table.drive_for([felt], quiet, level_db=20)
    print(drive)  # solved for these very positions; a steady drive takes time to build up
