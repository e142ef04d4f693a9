"""Objects of `tactable` for notebooks: bars, tables and what is played, as labelled arrays and pictures."""
