"""Perception experiments: what a person feels, asked by forced choice while the live engine plays, to a report."""
