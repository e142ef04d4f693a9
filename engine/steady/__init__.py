"""Steady drives for fingers at any positions, solved when fingers come.

`engine.steady.solver` needs Numba, so it is imported only by who solves; receptances and drives need no compiler.
"""

from engine.steady.drive import SteadyDrive
from engine.steady.receptances import Receptances

__all__ = ["Receptances", "SteadyDrive"]
