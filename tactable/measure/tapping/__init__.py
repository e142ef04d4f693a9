"""A surface that is tapped in place of driven: recorded taps to responses per newton, or to modes."""
