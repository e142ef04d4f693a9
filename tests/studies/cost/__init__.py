"""Studies of what things cost: processor time, memory, and how they grow."""
