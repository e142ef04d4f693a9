"""A program with two buttons on a plate, a slider along it and a fader across it, each with its own feel.

tactable demo reference-p --control          (in another terminal; SIMULATED, touch the plate on its page)
python examples/controls_on_a_plate.py
"""

import sys

import tactable

with tactable.connect(
    *sys.argv[1:], name="controls on a plate"
) as run:  # the run's socket; by default that of this user
    run.settings(rule_file=False)  # only these controls are felt
    run.define("notch", [["click", "15 dB"]])
    # A rectangle reaches from one corner to the one across from it: along the plate x across it.
    run.set_region("Mute", ["20 x 120 mm", "90 x 160 mm"], touch="press", lift="release")
    run.set_region("Solo", ["110 x 120 mm", "180 x 160 mm"], touch="press", lift="release")
    # Only what a finger travels along the slider counts; across it, it may wander.
    run.set_region("Pan", ["20 x 50 mm", "200 x 90 mm"], drag={"effect": "notch", "every": "10 mm", "along": "x"})
    run.set_region("Volume", ["230 x 20 mm", "280 x 160 mm"], drag={"effect": "notch", "every": "5 mm", "along": "y"})
    run.subscribe("touches")
    for event in run.events():  # until the run ends, or Ctrl-C; the controls end with this program
        if event["event"] == "touches":
            print("touched:", ", ".join(finger["region"] or "nothing" for finger in event["fingers"]), flush=True)
