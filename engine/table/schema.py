"""The arrays of a table file as its readers expect them: dimensions, kind of value, and which values stand for absence.

This is the declaration that an opened file is checked against (engine.table.soundness). tables/FORMAT.md says what the
arrays mean. An array that is not declared here must still be plain numbers or text, since a table may hold arrays of a
later revision that this program does not read.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from base.errors import TactableError


class TableError(TactableError):
    """A table that cannot be used: missing, truncated, corrupted, foreign, newer or stale; the message says which."""


class Kind(StrEnum):
    """What an array is made of, by the letters of numpy's kinds."""

    REAL = "f"
    WHOLE = "iu"
    TEXT = "O"


@dataclass(frozen=True)
class ArrayKind:
    """What an array must be: its dimensions, its kind, and the values that it may have beside finite numbers."""

    dimensions: tuple[str, ...]
    kind: Kind = Kind.REAL
    may_be_nan: bool = False
    may_be_infinite: bool = False
    least: float | None = None
    greatest: float | None = None


FIXED_SIZES = {"part": 2}  # dimensions that have one size in every table; those of actuators and zones are the device's


def _arrays(dimensions: str, *names: str, **properties: object) -> dict[str, ArrayKind]:
    """The same declaration for several arrays."""
    return {name: ArrayKind(tuple(dimensions.split()), **properties) for name in names}  # type: ignore[arg-type]


def _labels(*names: str) -> dict[str, ArrayKind]:
    """Texts along a dimension of their own name."""
    return {name: ArrayKind((name,), Kind.TEXT) for name in names}


_SWEEP_FIGURES = ("localized_factor", "peak_acceleration", "dead_spot")

SCHEMA: Mapping[str, Mapping[str, ArrayKind]] = {
    "responses": {
        **_labels("actuator", "zone", "part"),
        **_arrays("frequency", "frequency"),
        **_arrays("zone point", "position", "position_across"),
        **_arrays("frequency actuator zone point part", "acceleration"),
        **_arrays("frequency zone actuator actuator_2 part", "zone_gram"),
        **_arrays("frequency actuator actuator_2 part", "total_gram"),
        **_arrays("interval", "interval"),
        # Outside an actuator's band, and where a zone does not move, there is no relative error.
        **_arrays(
            "interval actuator",
            "localized_factor_error",
            "peak_acceleration_error",
            may_be_nan=True,
            may_be_infinite=True,
        ),
        **_arrays("", "sampling_error"),
    },
    "sweep": {
        **_labels("pair", "zone"),
        **{name: ArrayKind((name,)) for name in ("frequency_1", "amplitude_1", "amplitude_2", "frequency_2")},
        **_arrays("pair frequency_1 amplitude_1 amplitude_2 zone frequency_2", *_SWEEP_FIGURES, may_be_nan=True),
    },
    "coherent_sweep": {
        **_labels("pair", "zone"),
        **{name: ArrayKind((name,)) for name in ("frequency", "phase")},
        **_arrays("ratio", "amplitude_1", "amplitude_2"),
        **_arrays("pair frequency zone ratio phase", *_SWEEP_FIGURES, may_be_nan=True),
    },
    "best_rows": {
        **_labels("actuator", "zone"),
        **_arrays("level", "level", may_be_infinite=True),
        **_arrays("combination", "combination", kind=Kind.WHOLE, least=1),
        **_arrays("level combination", "group", "limited_by", kind=Kind.TEXT),
        **_arrays("level combination", "row", kind=Kind.WHOLE, least=0),
        **_arrays("level combination", "achieved", kind=Kind.WHOLE, least=0, greatest=1),
        **_arrays("level combination", "localized_factor", "reached_level"),
        **_arrays("level combination actuator", "drive_frequency", "drive_amplitude", least=0),
        **_arrays("level combination actuator", "drive_phase"),
        **_arrays("level combination zone", "share", "peak_acceleration", "dead_spot"),
    },
    "modes": {
        **_labels("actuator", "part"),
        **_arrays("frequency", "frequency", least=1e-3, greatest=1e6),
        **_arrays("frequency", "threshold", least=1e-9, greatest=1e6),
        **{name: ArrayKind((name,)) for name in ("along", "across")},
        **_arrays("across along function", "shape"),
        **_arrays("function actuator frequency part", "drive"),
        **_arrays("mode", "natural_frequency", "damping", least=0, greatest=1e18),
        **_arrays("mode actuator", "shape_at_actuator"),
        **_arrays("actuator", "damper"),
    },
    "clicks": {
        **_labels("actuator", "spread"),
        **_arrays("place", "place", "place_across"),
        **_arrays("sample", "sample"),
        **_arrays("level", "level", may_be_infinite=True),
        **_arrays("function sample", "basis_function", kind=Kind.WHOLE, least=-32768, greatest=32767),
        **_arrays("function", "function_actuator", "function_set", kind=Kind.WHOLE, least=0, greatest=255),
        **_arrays("set", "set_samples", kind=Kind.WHOLE, least=2),
        **_arrays("click finger", "finger_place", kind=Kind.WHOLE, least=-1),
        **_arrays("click finger", "finger_felt", kind=Kind.WHOLE, least=0, greatest=1),
        **_arrays("click weight_of_set", "weight", kind=Kind.WHOLE, least=-32768, greatest=32767),
        **_arrays("click", "fraction_bits", kind=Kind.WHOLE, least=0, greatest=31),
        **_arrays("click", "basis_set", kind=Kind.WHOLE, least=0),
        **_arrays("click spread", "felt_level"),
        **_arrays("click spread", "quiet_level", may_be_nan=True),
        **_arrays("click finger", "acceleration_at_finger", "sensation_level", may_be_nan=True),
        **_arrays("click level", "exceedance_time", may_be_nan=True),
        **_arrays("click", "peak_time", "residual_start", "residual_level"),
    },
    "measured": {},
}
"""Arrays by group and name."""

TEXT_ATTRIBUTES = (
    "format", "title", "Conventions", "device_name", "device_description", "device_fingerprint", "code_fingerprint",
    "code_version", "created", "source", "click_options",
    "responses_file", "responses_sha256", "modelled",
)  # fmt: skip
IS_SHIPPED = "is_shipped"  # attribute of a table that holds best rows and clicks alone, made to be small
WHOLE_ATTRIBUTES = (
    "format_revision",
    "clicks_up_to",
    IS_SHIPPED,
    "mesh_elements",
    "ritz_functions",
    "modes",
    "click_modes",
)
REAL_ATTRIBUTES = ("click_pitch_m", "click_tolerance_m", "mesh_longest_element_m")
