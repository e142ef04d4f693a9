"""Table rows to commands within the limits of the connected device."""
