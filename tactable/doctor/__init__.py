"""The doctor: checks of machine, ports, tables and digitizers, each with its remedy."""
