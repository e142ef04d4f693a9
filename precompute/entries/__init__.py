"""The best steady drive of every state, with its bound."""
