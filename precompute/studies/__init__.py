"""Studies of a design: placement of actuators, resolution of zones, reach."""
