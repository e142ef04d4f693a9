"""Options of the clicks of a device, and those of the coarse clicks that a table has until its own are solved."""

from dataclasses import dataclass, replace

from engine.touch.places import Places

DIGITIZER_TOLERANCE_M = 1e-3
"""A finger lies within this distance of where the digitizer tells."""
COARSE_PITCH_M, COARSE_GAIN = 16e-3, 0.3


@dataclass(frozen=True)
class ClickOptions:
    """Requirements on clicks, and the effort to solve them.

    lengths_s: tried in turn until one reaches `wanted_db`. wanted_db: level that every felt finger reaches in 95 % of
    the sampled plants, and no more; None: the strongest. quiet_db: level that no quiet finger exceeds in 95 % of them.
    brake_s: time from which the felt fingers are limited like the quiet ones. slew_per_s: limit of the rate of
    displacement, full scales a second. pitch_m: greatest distance of neighbouring places of a table. tolerance_m: a
    finger lies within this distance of its place; None: within that of the device's spread, or in a table within half a
    pitch and what the digitizer leaves. crowding: tones for each 1/length of an actuator's band. scenarios, trimmed,
    judged: numbers of sampled plants to optimise over, to trim on and to evaluate with; each has a seed of its own.
    search_gain: instants that promise less than this relative gain of the felt level are not pursued: 1e-2 is 0.09 dB.
    """

    lengths_s: tuple[float, ...] = (0.03,)
    wanted_db: float | None = None
    quiet_db: float = 0.4
    brake_s: float | None = None
    slew_per_s: float | None = None
    pitch_m: float = 3e-3
    tolerance_m: float | None = None
    crowding: float = 1.5
    scenarios: int = 40
    trimmed: int = 800
    judged: int = 200
    search_gain: float = 1e-2
    seed: int = 1

    def at(self, places: Places) -> "ClickOptions":
        """The options for clicks that are tabulated at these places."""
        if self.tolerance_m is not None:
            return self
        return replace(self, tolerance_m=places.pitch_m / 2 + DIGITIZER_TOLERANCE_M)

    @property
    def coarse(self) -> "ClickOptions":
        """Options of clicks that are solved in seconds: fewer places and sampled plants, with promises as honest."""
        return replace(
            self,
            pitch_m=max(self.pitch_m, COARSE_PITCH_M),
            search_gain=max(self.search_gain, COARSE_GAIN),
            scenarios=min(self.scenarios, 20),
            trimmed=min(self.trimmed, 200),
            judged=min(self.judged, 100),
        )

    @property
    def quick(self) -> "ClickOptions":
        """Options of a click that fingers wait for: fewer sampled plants, with a promise as honest."""
        few = {"scenarios": 12, "trimmed": 400, "judged": 100}
        return replace(self, **{name: min(count, getattr(self, name)) for name, count in few.items()})


DEFAULT_OPTIONS = ClickOptions()
