"""What a fleet is made of: units, what is to be done with each, and what came of it."""

import hashlib
import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path

from engine.device.values import Value
from precompute.builder.build import code_fingerprint
from precompute.calibration.misfit import Loss
from precompute.entries.objective import DEFAULT_OBJECTIVE, OBJECTIVES
from precompute.fleet.error import FleetError

NAME = re.compile(r"[\w+-][\w.+-]{0,63}")
"""Of a unit: its results go to a folder of this name."""


@dataclass(frozen=True)
class Unit:
    """One device of a fleet.

    `values` replace those of its file, by name as in actuator[1].stiffness, as text with a unit. With a `judged` table
    no other is built: what its drives do on this device is what is asked.
    """

    name: str
    device: Path
    measurements: Path | None = None
    values: Mapping[str, str] = field(default_factory=dict)
    judged: Path | None = None


@dataclass(frozen=True)
class Recipe:
    """What is done with every unit: how it is calibrated, if it was measured, and what its table is to hold.

    parameters: what is fitted, by name; None: the usual six. `also`: what is fitted besides. Raises FleetError for an
    objective or a loss that there is not.
    """

    objective: str = DEFAULT_OBJECTIVE
    clicks_up_to: int | None = None
    loss: str = "robust"
    parameters: tuple[str, ...] | None = None
    also: tuple[str, ...] = ()
    sensor_mass_kg: float = 0.0

    def __post_init__(self) -> None:
        losses = [loss.value for loss in Loss]
        for what, name, known in (("objective", self.objective, list(OBJECTIVES)), ("loss", self.loss, losses)):
            if name not in known:
                raise FleetError(f"there is no {what} {name!r}; choose one of {', '.join(known)}")


@dataclass(frozen=True)
class Job:
    """A unit with its recipe and its folder. `key` is a fingerprint of all that decides what comes of it."""

    unit: Unit
    recipe: Recipe
    folder: Path
    created: str
    code_fingerprint: str
    key: str


@dataclass(frozen=True)
class Outcome:
    """What came of a unit; with an `error`, nothing but that.

    values: the device's, after calibration (engine.device.values). figures: those of its table, by name.
    """

    name: str
    key: str
    seconds: float = 0.0
    error: str | None = None
    fingerprint: str = ""
    table_crc32: int | None = None
    """None: no table was built."""
    values: Mapping[str, Value] = field(default_factory=dict)
    figures: Mapping[str, float | None] = field(default_factory=dict)
    doubts: tuple[str, ...] = ()
    is_kept: bool = False
    """It was complete already."""

    def as_json(self) -> str:
        """Everything but whether it is kept."""
        return json.dumps({key: value for key, value in asdict(self).items() if key != "is_kept"}, indent=1)


def make_job(unit: Unit, recipe: Recipe, out: Path, created: str) -> Job:
    """Raises OSError where a file of the unit cannot be read."""
    files = [file for file in (unit.device, unit.measurements, unit.judged) if file is not None]
    wanted = {**asdict(recipe), "values": dict(unit.values), "judge": unit.judged is not None}
    parts = [code_fingerprint(), json.dumps(wanted)]
    parts += [hashlib.sha256(path.read_bytes()).hexdigest() for path in files]
    key = hashlib.sha256("\0".join(parts).encode()).hexdigest()
    return Job(unit, recipe, out / unit.name, created, code_fingerprint(), key)


def checked_units(units: Iterable[Unit], source: str) -> list[Unit]:
    """The units, refused where two share a name or a folder cannot have it. Raises FleetError."""
    found: dict[str, Unit] = {}
    for unit in units:
        if not NAME.fullmatch(unit.name):
            raise FleetError(f"{source}: {unit.name!r}: expected a name of letters, digits, _ . + or -, for a folder")
        if unit.name in found:
            raise FleetError(f"{source}: {unit.name!r}: two units have this name")
        found[unit.name] = unit
    if not found:
        raise FleetError(f"{source}: has no unit; give at least one")
    return list(found.values())
