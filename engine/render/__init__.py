"""Table rows to commands that the connected device can bear."""
