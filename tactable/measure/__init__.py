"""Driving a bar by hand or by plan, and recording what sensors read of it."""
