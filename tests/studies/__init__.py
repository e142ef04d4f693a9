"""Proofs that take long: what the model says, what things cost, and what is to be relied on."""
