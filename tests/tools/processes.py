"""Numbers of processes, for what is named by them."""

NO_PROCESS = 2**22 + 1
"""No process has it: Linux gives numbers up to 2**22."""
