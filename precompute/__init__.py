"""Off-line: a device description becomes a table."""

import os

# Kernels are many and short. OpenMP's threads spin at each barrier by default: on a machine that is busy with anything
# else, five times slower than threads that sleep. Read when numba loads its threads, so it is set before.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
