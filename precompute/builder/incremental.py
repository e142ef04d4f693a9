"""Incremental builds: which parts of a table are still right, and which must be computed again.

A table has two parts: the responses of the surface with its modes and sweeps, and the clicks. For each part it holds
the fingerprint of the inputs that the part was computed from: the code, the values of the device that the part depends
on, and the options of the build. A part of an earlier table is taken over only if that fingerprint is equal. Values are
left out of a fingerprint where the part provably does not depend on them (a name, a lease, for clicks the sweep), and
everything else is in it, so that a value which is added to the device makes parts stale, not wrong.
"""

import hashlib
import json
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any

from base.points import json_of
from engine.device import Device
from engine.table import Table, TableError
from precompute.clicks import ClickOptions
from precompute.clicks.click_options import read_click_options


class Part(StrEnum):
    """A part of a table, which is computed or taken over as a whole."""

    RESPONSES = "responses"
    CLICKS = "clicks"

    @property
    def attribute(self) -> str:
        """The table's attribute that holds the fingerprint of the part's inputs."""
        return f"{self.value}_input_fingerprint"

    @property
    def groups(self) -> tuple[str, ...]:
        """The groups of the file that hold the part."""
        of_responses = ("responses", "modes", "sweep", "coherent_sweep", "best_rows", "measured")
        return of_responses if self is Part.RESPONSES else (self.value,)


@dataclass(frozen=True)
class BuildOptions:
    """Everything beside the device that decides what is in a table."""

    code_fingerprint: str
    clicks_up_to: int
    click_options: ClickOptions
    responses_sha256: str = ""  # SHA-256 of the file of measured responses; "" where the responses are the model's

    @classmethod
    def of(cls, table: Table) -> "BuildOptions":
        """The options that a table was built with. Raises TableError for a table that does not note known ones."""
        values = table.attributes
        if "clicks_up_to" not in values:
            raise TableError(f"{table.path}: does not say what it was built by; build it again with this version")
        return cls(
            code_fingerprint=str(values["code_fingerprint"]),
            clicks_up_to=int(values["clicks_up_to"]),
            click_options=read_click_options(table),
            responses_sha256=str(values.get("responses_sha256", "")),
        )


# Responses are those of the untouched surface, drives at frequencies that resonances under fingers decide; best rows
# of the sweep reach the levels within the limit.
_RESPONSES = ("surface", "actuators", "zones", "sweep", "finger", "threshold", "levels_db", "limits")
# Only the engine or a person reads these.
_IDLE = ("name", "description", "zone_hysteresis_m", "touch_axis", "inferred", "text", "finger_origin")


def input_fingerprint(part: Part, device: Device, options: BuildOptions) -> str:
    """SHA-256 (hex) over everything that a part is computed from."""
    values = {key: value for key, value in asdict(device).items() if key not in _IDLE}
    values["limits"].pop("lease_s")
    values["threshold"] = device.threshold.values
    chosen: dict[str, Any] = {"code": options.code_fingerprint}
    match part:
        case Part.RESPONSES:
            values = {key: values[key] for key in _RESPONSES}
            values["finger"].pop("spread")
            values["limits"] = values["limits"]["amplitude"]
            chosen["responses"] = options.responses_sha256
        case Part.CLICKS:
            values.pop("sweep")
            chosen |= {
                "clicks_up_to": options.clicks_up_to,
                "options": asdict(options.click_options.on(device.surface.corner_m)),
            }
    return hashlib.sha256(json.dumps(chosen | values, sort_keys=True, default=json_of).encode()).hexdigest()


def is_current(table: Table, device: Device, options: BuildOptions) -> bool:
    """Whether a table is what a build would make now."""
    wanted = set(Part) if options.clicks_up_to else {Part.RESPONSES}
    return table.fingerprint == device.fingerprint and all(
        table.attributes.get(part.attribute) == input_fingerprint(part, device, options) for part in wanted
    )


def is_compatible(before: Device, device: Device) -> bool:
    """Whether what was made for a device may be played on another.

    They have the same length, zones, actuators, limits and threshold, by which the levels of both are named.
    """
    names = [[actuator.name for actuator in each.actuators] for each in (before, device)]
    is_as_long = before.surface.corner_m == device.surface.corner_m
    if before.threshold.values != device.threshold.values:
        return False
    return is_as_long and before.zones == device.zones and before.limits == device.limits and names[0] == names[1]
