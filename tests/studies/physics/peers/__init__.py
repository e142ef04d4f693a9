"""Plates of other works as device files; what they do not publish is an estimate, and marked so."""
