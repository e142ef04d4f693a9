"""One thread from report to command: the pure pipeline, the loop around it, and what observes them."""
