"""The control channel: programs decide who feels what, trigger effects, and hear what was touched and played."""
