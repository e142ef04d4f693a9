"""Best clicks of placements of the fingers over sampled plants; click_solver.py says what a click is."""

from precompute.clicks.click_options import DEFAULT_OPTIONS, ClickOptions
from precompute.clicks.click_solver import ClickSolver

__all__ = ["DEFAULT_OPTIONS", "ClickOptions", "ClickSolver"]
