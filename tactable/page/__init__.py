"""The live page: a browser as digitizer and as display; no engine runs in its process."""
