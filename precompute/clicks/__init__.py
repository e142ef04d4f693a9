"""Best clicks of placements of the fingers over sampled plants; solver.py says what a click is."""

from precompute.clicks.options import DEFAULT_OPTIONS, ClickOptions
from precompute.clicks.solver import Click, ClickSolver

__all__ = ["DEFAULT_OPTIONS", "Click", "ClickOptions", "ClickSolver"]
