"""What is asked of a device's clicks."""

from dataclasses import dataclass


@dataclass(frozen=True)
class ClickOptions:
    """What is asked of clicks.

    lengths_s: tried one after another, until one reaches `wanted_db`. wanted_db: what 95 % of sampled plants are to
    reach under every felt finger, the click is no stronger than that; None: as strong as can be. quiet_db: what 95 %
    keep to under every quiet finger. brake_s: from then on the felt fingers keep to what the quiet ones do. slew_per_s:
    of the displacement, fractions of full scale. crowding: tones for each 1/length of the band. The program is solved
    over `scenarios`, its level trimmed on `trimmed`, the figures are of `judged`: plants of three seeds.
    """

    lengths_s: tuple[float, ...] = (0.03,)
    wanted_db: float | None = None
    quiet_db: float = 0.4
    brake_s: float | None = None
    slew_per_s: float | None = None
    crowding: float = 1.5
    scenarios: int = 40
    trimmed: int = 800
    judged: int = 200
    seed: int = 1


DEFAULT_OPTIONS = ClickOptions()
