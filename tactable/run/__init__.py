"""A live run: table, source and port to a loop, with its companions."""
