"""The firmware in Python, with its faults, behind a pseudo-terminal."""
