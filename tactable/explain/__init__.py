"""Why an entry or a click is what it is."""
