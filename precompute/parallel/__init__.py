"""Several processes, and how they end."""
