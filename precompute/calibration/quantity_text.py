"""An SI value with its unit as a person writes it, and as a device file reads it."""

from collections.abc import Sequence

_SHOWN = {"N/m": (1e3, "kN/m"), "m": (1e-6, "µm"), "kg": (1e-3, "g"), "Pa": (1e9, "GPa")}


def quantity_text(value: float, unit: str, digits: int = 4) -> str:
    """Such as "18.9 kN/m" of 18900.0, "N/m"."""
    scale, shown = _SHOWN.get(unit, (1.0, unit))
    return f"{value / scale:.{digits}g} {shown}"


def interval_text(ends: Sequence[float], unit: str, digits: int = 4) -> str:
    """Such as "18.9 to 19.1 kN/m"."""
    scale, shown = _SHOWN.get(unit, (1.0, unit))
    low, high = ends
    return f"{low / scale:.{digits}g} to {high / scale:.{digits}g} {shown}"
