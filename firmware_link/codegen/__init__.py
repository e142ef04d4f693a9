"""Generators of the C headers, the test vectors and the table of messages from the Python definitions."""
