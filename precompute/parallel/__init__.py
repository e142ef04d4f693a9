"""Worker processes, and an interrupt that is not lost."""
