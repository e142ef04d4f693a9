"""One line of a table: the drive for one state of the zones, and what it promises."""

from dataclasses import dataclass

from engine.zones import ZoneState, state_index


@dataclass(frozen=True)
class ZonePromise:
    """What one zone does under the drive, in steady state, at the amplitudes of the entry."""

    name: str
    state: ZoneState
    share: float
    """Localized factor of the zone: its share of the kinetic energy."""
    peak_acceleration_m_per_s2: float
    peak_position_m: float
    dead_acceleration_m_per_s2: float
    """Least acceleration in the zone, and where."""
    dead_position_m: float


@dataclass(frozen=True)
class Entry:
    """Per actuator: frequency, amplitude as a fraction of full scale, phase; and the figures the table promises."""

    frequencies_hz: tuple[float, ...]
    amplitudes: tuple[float, ...]
    phases_rad: tuple[float, ...]
    zones: tuple[ZonePromise, ...]
    localized_factor: float
    """Share of the felt zones together."""
    upper_bound: float
    """No drive with any frequency, amplitude and phase has a greater localized factor."""
    contrast_db: float | None
    """Energy per length, felt zones over the rest of the bar; None when nothing is left."""
    t90_s: float
    """From rest: the time after which every felt zone's envelope stays within 10 % of its final value."""
    family: str
    """"single tone", "two tones" or "coherent"."""
    limited_by: str
    achieved: bool
    """False: the level floor cannot be reached in every felt zone; the drive is the best possible."""

    @property
    def states(self) -> tuple[ZoneState, ...]:
        """State of each zone."""
        return tuple(zone.state for zone in self.zones)

    @property
    def index(self) -> int:
        """The state as one number (engine.zones.state_index)."""
        return state_index(self.states)
