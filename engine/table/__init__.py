"""The table file: entries, clicks and sweeps, read, written and compared."""
