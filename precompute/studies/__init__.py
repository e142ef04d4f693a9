"""Questions about a design: placement, resolution, reach."""
