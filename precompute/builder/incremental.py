"""A table's parts, and what of a device each rests on: a part is computed again only if some of that has changed."""

import hashlib
import json
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any

from engine.device import Device
from engine.table import Table, TableError
from precompute.clicks import ClickOptions
from precompute.entries.prediction import MadeFor


class Part(StrEnum):
    """What is computed, or taken over from an earlier table, as one."""

    RESPONSES = "responses"
    ENTRIES = "entries"
    CLICKS = "clicks"

    @property
    def attribute(self) -> str:
        """The table's attribute with the fingerprint of what the part rests on."""
        return f"{self.value}_rest_on"

    @property
    def groups(self) -> tuple[str, ...]:
        """The groups of the file that hold it."""
        return ("responses", "sweep", "coherent_sweep", "measured") if self is Part.RESPONSES else (self.value,)


@dataclass(frozen=True)
class Recipe:
    """All that decides what is in a table, beside the device."""

    code_fingerprint: str
    objective: str
    clicks_up_to: int
    click_options: ClickOptions
    responses_sha256: str = ""
    """Of the file of measured responses; "": they are the model's."""
    made_for: MadeFor = MadeFor.MEAN

    @classmethod
    def of(cls, table: Table) -> "Recipe":
        """What a table was built by. Raises TableError for a table of a version that did not note it."""
        values = table.attributes
        if "clicks_up_to" not in values:
            raise TableError(f"{table.path}: does not say what it was built by; build it again with this version")
        options = json.loads(str(values["click_options"]))
        return cls(
            code_fingerprint=str(values["code_fingerprint"]),
            objective=str(values["objective"]),
            clicks_up_to=int(values["clicks_up_to"]),
            click_options=ClickOptions(**options | {"lengths_s": tuple(options["lengths_s"])}),
            responses_sha256=str(values.get("responses_sha256", "")),
            made_for=MadeFor(str(values["made_for"])),
        )


OUTDATED = "outdated"
"""The table's attribute that names the parts, parted by spaces, that are still of the device as it was before."""
KEPT_FOR_NOW = (Part.CLICKS,)
"""What a build may leave for later, since it takes minutes."""

# The untouched bar.
_RESPONSES = ("bar", "actuators", "zones", "sweep")
# What only the engine uses, and words.
_IDLE = ("name", "description", "zone_hysteresis_m", "touch_axis", "inferred", "text")


def rests_on(part: Part, device: Device, recipe: Recipe) -> str:
    """SHA-256 (hex) over everything that decides what is in a part."""
    values = {key: value for key, value in asdict(device).items() if key not in _IDLE}
    values["limits"].pop("lease_s")
    chosen: dict[str, Any] = {"code": recipe.code_fingerprint}
    match part:
        case Part.RESPONSES:
            values = {key: values[key] for key in _RESPONSES}
            chosen["responses"] = recipe.responses_sha256
        case Part.ENTRIES:
            chosen |= {"objective": recipe.objective, "responses": recipe.responses_sha256}
            chosen["made_for"] = recipe.made_for
        case Part.CLICKS:
            values.pop("sweep")
            chosen |= {"clicks_up_to": recipe.clicks_up_to, "options": asdict(recipe.click_options)}
    return hashlib.sha256(json.dumps(chosen | values, sort_keys=True).encode()).hexdigest()


def outdated_parts(table: Table) -> tuple[Part, ...]:
    """Parts of a table that were made for the device as it was before."""
    names = str(table.attributes.get(OUTDATED, "")).split()
    return tuple(part for part in Part if part in names)


def is_current(table: Table, device: Device, recipe: Recipe) -> bool:
    """Whether a table is what a build would make, but for its outdated parts."""
    left = set(Part) - set(outdated_parts(table))
    return table.fingerprint == device.fingerprint and all(
        table.attributes.get(part.attribute) == rests_on(part, device, recipe) for part in left
    )


def plays_on(before: Device, device: Device) -> bool:
    """Whether what was made for a device may be played on another: the same zones, actuators and limits."""
    names = [[actuator.name for actuator in each.actuators] for each in (before, device)]
    return before.zones == device.zones and before.limits == device.limits and names[0] == names[1]
