"""Rules that decide what each finger feels, and the player that follows them."""
