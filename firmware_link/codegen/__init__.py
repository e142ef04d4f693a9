"""C headers and test vectors made from the Python definitions."""
