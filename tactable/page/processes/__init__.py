"""Child processes of the page: builds, engine, emulated firmware, and the page of a live run."""
