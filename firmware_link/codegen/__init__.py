"""Generators of the C headers and of the table of messages in PROTOCOL.md from the Python definitions."""
