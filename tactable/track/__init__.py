"""A finger and a drift that are measured while a run plays, by a sensor that stays on the surface."""
