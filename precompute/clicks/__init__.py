"""The best click of every state, by linear programs."""
