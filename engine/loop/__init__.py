"""One thread from report to command."""
