"""Entries: for every state of the fingers and every level the best steady drive, with an upper bound."""
