"""A table's parts, and what of a device each rests on: a part is computed again only if some of that has changed."""

import hashlib
import json
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any

from engine.device import Device
from precompute.click_options import ClickOptions


class Part(StrEnum):
    """What is computed, or taken over from an earlier table, as one."""

    RESPONSES = "responses"
    ENTRIES = "entries"
    CLICKS = "clicks"
    BURSTS = "bursts"

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
    bursts_up_to: int = 0


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
        case Part.CLICKS:
            values.pop("sweep")
            chosen |= {"clicks_up_to": recipe.clicks_up_to, "options": asdict(recipe.click_options)}
        case Part.BURSTS:
            values.pop("sweep")
            chosen |= {"bursts_up_to": recipe.bursts_up_to, "options": asdict(recipe.click_options)}
    return hashlib.sha256(json.dumps(chosen | values, sort_keys=True).encode()).hexdigest()
