"""A device to its table file: whole, incremental, or one state on demand."""
