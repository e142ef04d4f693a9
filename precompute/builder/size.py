"""Size of a table, and memory and time of its build, estimated from a device file before anything is computed.

The sweep of a pair of actuators grows with the square of the number of frequencies and of amplitudes, so a device file
of a few lines can ask for a petabyte. A build that cannot end is refused before it begins.
"""

import math
import os
import shutil
from pathlib import Path

from engine.device import Device
from engine.table import TableError
from precompute.sweep.grid import zone_points
from precompute.sweep.sweep_kernels import fold_amplitudes

_FIGURES, _SINGLE, _DOUBLE, _COMPLEX = 3, 4, 8, 16  # figures of a sweep; bytes of a number
_COPIES = 3  # responses are held as solved, by zone, and split into two parts while they are written
_CLICK_S, _PLATE_CLICK_S = 2.3e-3, 4.3e-3
"""Processor time of a click for each actuator: 5.1, 5.2 and 6.3 ms on reference-a, -d and -t, 17 ms on reference-p."""
_SWEPT_BYTES_PER_S = 120e6  # reference-a and -t
_UNITS = ("bytes", "kB", "MB", "GB", "TB", "PB", "EB")


def table_bytes(device: Device) -> int:
    """Bytes of the sweeps and responses of a table; clicks and modes add some MB."""
    rows = _pairs(device) * (_pair_values(device) + _coherent_values(device)) if device.sweep.is_stored else 0
    return _FIGURES * _SINGLE * rows + _responses(device)


def memory_bytes(device: Device) -> int:
    """Bytes that a build holds at once, beside the buffers of the pair sweep, which have a budget of their own."""
    row = _FIGURES * _SINGLE * _pair_values(device) // max(1, len(device.sweep.frequency_hz))
    return max(_FIGURES * _DOUBLE * _coherent_values(device), row) + _COPIES * _responses(device)


def expected_s(device: Device, clicks: int) -> float:
    """Processor time in s that a build with `clicks` clicks takes once its kernels are compiled. ESTIMATE."""
    of_click_s = _PLATE_CLICK_S if device.surface.corner_m.imag else _CLICK_S
    return clicks * len(device.actuators) * of_click_s + table_bytes(device) / _SWEPT_BYTES_PER_S


def check_size(device: Device, path: Path) -> None:
    """Raise TableError for a table that neither the disk of `path` nor the memory of this machine has room for."""
    remedy = "make the sweep coarser (sweep.step, sweep.amplitude_steps, sweep.phase_steps), or drop it (sweep.store)"
    folder = path.absolute().parent
    disk = shutil.disk_usage(folder) if folder.is_dir() else None
    wanted, free = table_bytes(device), math.inf if disk is None or not disk.total else disk.free  # 0: it does not say
    if wanted > free:
        raise TableError(
            f"{path}: a table of {device.name} takes {size_text(wanted)}, and {size_text(free)} are free there: "
            f"{remedy}, make room or choose another output"
        )
    wanted, there = memory_bytes(device), os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    if wanted > there:
        raise TableError(
            f"{path}: building a table of {device.name} takes {size_text(wanted)} of memory, and this machine has "
            f"{size_text(there)}: {remedy}"
        )


def _pairs(device: Device) -> int:
    return math.comb(len(device.actuators), 2)


def _pair_values(device: Device) -> int:
    """Values of one figure of one pair over (frequency_1, amplitude_1, amplitude_2, zone, frequency_2)."""
    if len(device.actuators) < 2:
        return 0
    return len(device.sweep.frequency_hz) ** 2 * (device.sweep.amplitude_steps + 1) ** 2 * len(device.zones)


def _coherent_values(device: Device) -> int:
    """Values of one figure of one pair over (frequency, zone, ratio, phase)."""
    if len(device.actuators) < 2:
        return 0
    ratios = len(fold_amplitudes(device.sweep.amplitude_steps).first)
    return len(device.sweep.frequency_hz) * len(device.zones) * ratios * device.sweep.phase_steps


def _responses(device: Device) -> int:
    return _COMPLEX * len(device.sweep.frequency_hz) * len(device.actuators) * zone_points(device).size


def size_text(size: float) -> str:
    """A size in bytes with three digits and its unit."""
    order = min(len(_UNITS) - 1, int(math.log10(max(size, 1)) / 3))
    return f"{size / 1000**order:.3g} {_UNITS[order]}"
