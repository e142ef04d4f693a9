"""The host's side: link, outbox, serial port."""
