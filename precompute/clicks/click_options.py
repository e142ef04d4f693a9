"""Options of the clicks of a device, and those that a table was made with."""

import json
import math
from dataclasses import dataclass, fields, replace
from typing import Any

from engine.device.parts import Spread
from engine.table import Table, TableError
from engine.touch.placement import Places

FINEST_M = 3e-3  # of neighbouring places on a bar: its clicks of one and two fingers are solved in a minute
MOST_PLACES = 900  # about, of a plate: clicks of one finger are solved in 20 s, and fit the compiled step


@dataclass(frozen=True)
class ClickOptions:
    """Requirements on clicks, and the effort to solve them.

    quiet_db: level that no quiet finger exceeds in 95 % of the sampled plants. pitch_m: greatest distance of
    neighbouring places of a table; None: FINEST_M, or what gives MOST_PLACES on a plate. tolerance_m: a finger lies
    within this distance of its place; None: within that of the device's spread. crowding: tones for each 1/length of an
    actuator's band. pool, judged: numbers of sampled plants to solve with, the first 60 of which make the click and the
    others trim it, and to evaluate with; each has a seed of its own. A spread of bars and channels doubles the pool.
    """

    length_s: float = 0.03
    quiet_db: float = 0.4
    pitch_m: float | None = None
    tolerance_m: float | None = None
    crowding: float = 1.5
    pool: int = 120
    judged: int = 160
    seed: int = 1

    def on(self, corner_m: complex) -> "ClickOptions":
        """The options with the pitch that they mean on a surface that reaches from 0 to `corner_m`."""
        coarse_m = math.sqrt(corner_m.real * corner_m.imag / MOST_PLACES)
        return replace(self, pitch_m=max(FINEST_M, coarse_m) if self.pitch_m is None else self.pitch_m)

    def places(self, corner_m: complex) -> Places:
        """The places of the table of a surface that reaches from 0 to `corner_m`."""
        return Places.every(corner_m, self.on(corner_m).pitch_m or FINEST_M)

    def at(self, places: Places, spread: Spread) -> "ClickOptions":
        """The options at these places: half a pitch beyond where a finger may be, unless a tolerance is given."""
        if self.tolerance_m is not None:
            return self
        return replace(self, tolerance_m=places.pitch_m / 2 + spread.reach_m)

    @property
    def waited_for(self) -> "ClickOptions":
        """The options for clicks that fingers wait for: as strong and as quiet, judged on fewer plants."""
        return replace(self.at_fingers, judged=min(80, self.judged))

    @property
    def at_fingers(self) -> "ClickOptions":
        """The options for clicks that are solved for the positions that the digitizer tells."""
        return replace(self, tolerance_m=None)


DEFAULT_OPTIONS = ClickOptions()


def read_click_options(table: Table) -> ClickOptions:
    """Read the attribute `click_options`. Raises TableError for options that this program does not know."""
    text = table.attributes.get("click_options")
    if text is None:
        return DEFAULT_OPTIONS
    values: dict[str, Any] = json.loads(str(text))
    unknown = sorted(set(values) - {field.name for field in fields(ClickOptions)})
    if unknown:
        raise TableError(f"{table.path}: its clicks have options unknown here: {', '.join(unknown)}; build it again")
    known: dict[str, Any] = {key: tuple(value) if isinstance(value, list) else value for key, value in values.items()}
    return ClickOptions(**known)
