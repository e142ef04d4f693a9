"""Off-line: a device description becomes a table."""

import os

# Kernels are many and short. OpenMP's threads spin at each barrier for about a millisecond by default: on a machine
# that is busy with anything else, four times slower than threads that soon sleep; threads that sleep at once wake too
# late. Read when numba loads its threads, so it is set before.
os.environ.setdefault("GOMP_SPINCOUNT", "3000")
