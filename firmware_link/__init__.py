"""THE WIRE: commands to bytes and back; imports nothing of ours."""
