"""One shaped burst of a table: the drive for one state of the zones behind timed steps, and what it promises."""

import math
from dataclasses import dataclass, replace

from engine.table.click import LevelSpread
from engine.table.entry import LEVEL_TOLERANCE_DB
from engine.touch import ZoneState, state_index
from firmware_link.host.link_values import Capabilities
from firmware_link.protocol.messages import (
    NUMBER_OF_SHAPES,
    SHAPE_FULL_GAIN,
    SHAPE_STEPS,
    SHAPE_TIME_US,
    Features,
)
from firmware_link.protocol.onset import OnsetStep

__all__ = [
    "NUMBER_OF_SHAPES",
    "SHAPE_FULL_GAIN",
    "SHAPE_STEPS",
    "SHAPE_TIME_US",
    "BurstEntry",
    "OnsetStep",
    "Shape",
    "needs_bursts",
    "played_at",
]

Shape = tuple[OnsetStep, ...]
"""Steps that a device remembers, with the gain 1 after the last."""


@dataclass(frozen=True)
class BurstEntry:
    """Per actuator: frequency, amplitude as a fraction of full scale, phase at the start; steps, stop and figures.

    The steps multiply the amplitudes, which may be raised so: full scale is that of the loudest step. From `stop_s` on
    the amplitudes are 0, and every change passes the slew of the device's limits.
    """

    states: tuple[ZoneState, ...]
    frequencies_hz: tuple[float, ...]
    amplitudes: tuple[float, ...]
    phases_rad: tuple[float, ...]
    shape: int
    """Which of the table's shapes."""
    stop_s: float
    felt: LevelSpread
    """The weakest felt finger."""
    quiet: LevelSpread | None
    """The strongest quiet finger; None: nothing is quiet."""
    wanted_level_db: float = math.inf
    """The level asked for; infinite: as strong as it is."""
    achieved: bool = True
    """False: full scale and the quiet level allow less than the wanted level."""

    @property
    def index(self) -> int:
        """The state as one number (engine.touch.finger_tracker.state_index)."""
        return state_index(self.states)

    @property
    def level_db(self) -> float:
        """What 95 % of the sampled plants reach under every felt finger."""
        return self.felt.low_db


def played_at(burst: BurstEntry, level_db: float) -> BurstEntry:
    """The burst played softer, so that 95 % of the plants reach `level_db` and no more; never louder than tabulated.

    All levels fall together, as those of a click do. ESTIMATE: a softer drive has shorter ramps, so not quite.
    """
    change_db = min(0.0, level_db - burst.level_db)
    scale = 10 ** (change_db / 20)
    return replace(
        burst,
        amplitudes=tuple(amplitude * scale for amplitude in burst.amplitudes),
        wanted_level_db=level_db,
        achieved=burst.achieved and (math.isinf(level_db) or burst.level_db >= level_db - LEVEL_TOLERANCE_DB),
        felt=burst.felt.changed(change_db),
        quiet=None if burst.quiet is None else burst.quiet.changed(change_db),
    )


def needs_bursts(capabilities: Capabilities) -> bool:
    """Whether bursts take the place of clicks on the device: it shapes onsets and plays no waveforms."""
    features = capabilities.features
    return Features.ONSET_SHAPES in features and Features.WAVEFORMS not in features
