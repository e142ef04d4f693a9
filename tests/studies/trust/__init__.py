"""Studies of what is to be relied on: faults, kills, fuzzers, mutants, long sessions."""
