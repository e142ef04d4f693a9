"""Where touches come from: the only modules that read reports."""
