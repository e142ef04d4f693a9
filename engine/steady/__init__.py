"""Steady drives for fingers at any positions, solved when fingers come.

`engine.steady.steady_solver` needs Numba, so only who solves imports it; modes and drives need no compiler.
"""

from engine.steady.modes import Modes
from engine.steady.steady_drive import SteadyDrive

__all__ = ["Modes", "SteadyDrive"]
