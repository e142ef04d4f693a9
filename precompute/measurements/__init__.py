"""Measured accelerations and responses, in the forms laboratories have them."""
