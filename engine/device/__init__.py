"""A bar with all that is on it: values, files and units."""
