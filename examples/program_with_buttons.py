"""A program with two buttons on the bar, each with the click of its press and of its release.

tactable demo --control          (in another terminal; SIMULATED, touch the bar on its page)
python examples/program_with_buttons.py
"""

import sys
from typing import Any

import tactable


def print_touched(fingers: list[dict[str, Any]]) -> None:
    """Print the names of the buttons under the fingers."""
    print("touched:", ", ".join(finger["region"] or "no button" for finger in fingers) or "nothing", flush=True)


with tactable.connect(*sys.argv[1:], name="two buttons") as run:  # the run's socket; by default that of this user
    run.settings(rule_file=False)  # only the buttons are felt
    run.set_region("OK", ["20 mm", "60 mm"], touch="press", lift="release")
    run.set_region("Cancel", ["200 mm", "240 mm"], touch="press", lift="release")
    print_touched(run.subscribe("touches", "played"))
    for event in run.events():  # until the run ends, or Ctrl-C; the buttons end with this program
        if event["event"] == "touches":
            print_touched(event["fingers"])
        elif event["event"] == "played" and (promise := event["promise"]):
            print(f"{event['kind']}: {promise['felt_at_least_db']} dB or more for 95 % of the sampled bars and fingers")
