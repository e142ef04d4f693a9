"""Messages, framing and limits of the wire."""
