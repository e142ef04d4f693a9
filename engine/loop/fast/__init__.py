"""The compiled step: an accelerator of the loop, checked against it at every report."""
