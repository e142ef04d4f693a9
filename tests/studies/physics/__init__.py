"""Studies of what the model says: its agreement with the paper, calibrations, clicks and drives."""
