"""OFF-LINE: device in, table out."""
