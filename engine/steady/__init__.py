"""Steady drives for fingers at any positions, solved when fingers come.

`engine.steady.steady_solver` needs Numba, so it is imported only by who solves; receptances and drives need no
compiler.
"""

from engine.steady.receptances import Receptances
from engine.steady.steady_drive import SteadyDrive

__all__ = ["Receptances", "SteadyDrive"]
