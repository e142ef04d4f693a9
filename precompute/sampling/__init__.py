"""Sampled fingers, plants and bars: what may be met."""
