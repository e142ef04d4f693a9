"""What every room stands on: the root of errors, files, child processes, trust in caches, kept machine code."""
