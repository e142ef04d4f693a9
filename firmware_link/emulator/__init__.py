"""The firmware in Python with virtual time, its faults, and its process behind a pseudo-terminal."""
