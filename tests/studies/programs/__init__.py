"""Studies of what programs and their files get."""
