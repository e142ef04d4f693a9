"""What notebooks import of `tactable`: bars, tables and what is played, as labelled arrays and pictures."""
