"""Clock of the device, estimated from round trips: offset as bounds, drift by decayed regression."""

import math
from dataclasses import dataclass

NS_PER_US = 1_000
NS_PER_S = 1_000_000_000
DRIFT_BOUND = 200e-6  # two ordinary crystals, 100 ppm each: the most that old bounds may have moved
DRIFT_MEMORY_S = 60.0  # an exchange is forgotten at this pace, since temperature changes the drift
# Below this standard deviation in time the noise of the round trips outweighs any crystal's drift.
DRIFT_BASELINE_S = 5.0


@dataclass(frozen=True)
class Exchange:
    """One round trip: host sent, device received, device sent, host received."""

    host_sent_ns: int
    device_received_us: int
    device_sent_us: int
    host_received_ns: int

    def offset_bounds(self) -> "OffsetBounds":
        """Bounds from this round trip alone: a message arrives after it left."""
        # A device time is cut to whole microseconds: the request came up to one later than it says.
        upper_ns = (self.device_received_us + 1) * NS_PER_US - self.host_sent_ns
        return OffsetBounds(self.device_sent_us * NS_PER_US - self.host_received_ns, upper_ns)


@dataclass(frozen=True)
class OffsetBounds:
    """Bounds of device clock minus host clock; true as long as the clocks keep to DRIFT_BOUND."""

    lower_ns: float
    upper_ns: float

    @property
    def middle_ns(self) -> float:
        """The estimate of the offset."""
        return (self.lower_ns + self.upper_ns) / 2

    @property
    def half_width_ns(self) -> float:
        """The greatest error of the middle."""
        return (self.upper_ns - self.lower_ns) / 2

    def widened(self, elapsed_ns: float) -> "OffsetBounds":
        """The bounds this much later or earlier."""
        margin_ns = abs(elapsed_ns) * DRIFT_BOUND
        return OffsetBounds(self.lower_ns - margin_ns, self.upper_ns + margin_ns)

    def intersection(self, other: "OffsetBounds") -> "OffsetBounds | None":
        """Offsets that both allow; None where they contradict each other."""
        lower_ns, upper_ns = max(self.lower_ns, other.lower_ns), min(self.upper_ns, other.upper_ns)
        return OffsetBounds(lower_ns, upper_ns) if lower_ns <= upper_ns else None


class DeviceClock:
    """The device's clock as the host knows it; `drift` is the device's pace over the host's, less 1."""

    def __init__(self) -> None:
        self.exchanges = 0
        self.contradictions = 0
        self.drift = 0.0
        self._bounds: OffsetBounds | None = None
        self._middle_ns = 0.0
        self._bounds_at_ns = 0
        self._regression = _DecayedRegression()

    def update(self, exchange: Exchange) -> None:
        """Take a round trip in; one that contradicts the earlier ones starts the estimate afresh, and is counted."""
        now_ns = exchange.host_received_ns
        bounds = exchange.offset_bounds()
        if self._bounds is not None:
            common = bounds.intersection(self.offset_bounds(now_ns))
            if common is None:
                self.contradictions += 1
                self._regression = _DecayedRegression()
            self._bounds = common or bounds
        else:
            self._bounds = bounds
        self._middle_ns, self._bounds_at_ns = self._bounds.middle_ns, now_ns
        self.exchanges += 1
        self._regression.update(now_ns / NS_PER_S, bounds.middle_ns / NS_PER_S, bounds.half_width_ns / NS_PER_S)
        self.drift = self._regression.slope()

    def offset_bounds(self, host_ns: int) -> OffsetBounds:
        """Bounds of the offset at a host time; raises ValueError before the first exchange."""
        if self._bounds is None:
            raise ValueError("the clocks have not been compared yet")
        return self._bounds.widened(host_ns - self._bounds_at_ns)

    def line(self) -> tuple[int, float, float]:
        """Host time of the last exchange, middle of the bounds then, ns, and drift: what `device_time_us` uses."""
        return self._bounds_at_ns, self._middle_ns, self.drift

    def device_time_us(self, host_ns: int) -> int:
        """Device time at a host time, by the middle of the bounds and the drift since; raises ValueError as above."""
        if self._bounds is None:
            raise ValueError("the clocks have not been compared yet")
        drifted_ns = (host_ns - self._bounds_at_ns) * self.drift
        return int((host_ns + self._middle_ns + drifted_ns) // NS_PER_US)


class _DecayedRegression:
    """Slope of offset over time, in s/s; each point weighs the inverse square of its uncertainty and its age."""

    def __init__(self) -> None:
        self._last_s: float | None = None
        self._origin_offset_s = 0.0
        self._weight = self._time = self._offset = self._time_time = self._time_offset = 0.0

    def update(self, time_s: float, offset_s: float, uncertainty_s: float) -> None:
        """Add a point; the sums are kept relative to the latest one, which keeps them small."""
        if self._last_s is None:
            self._last_s, self._origin_offset_s = time_s, offset_s
        step_s = time_s - self._last_s
        decay = math.exp(-step_s / DRIFT_MEMORY_S)
        self._time_time = decay * (self._time_time - 2 * step_s * self._time + step_s**2 * self._weight)
        self._time_offset = decay * (self._time_offset - step_s * self._offset)
        self._time = decay * (self._time - step_s * self._weight)
        weight = 1 / max(uncertainty_s, 1e-6) ** 2
        self._weight = decay * self._weight + weight
        self._offset = decay * self._offset + weight * (offset_s - self._origin_offset_s)
        self._last_s = time_s

    def slope(self) -> float:
        """The slope within DRIFT_BOUND; 0 until the points span DRIFT_BASELINE_S."""
        spread = self._weight * self._time_time - self._time**2
        if spread <= (DRIFT_BASELINE_S * self._weight) ** 2:
            return 0.0
        slope = (self._weight * self._time_offset - self._time * self._offset) / spread
        return min(max(slope, -DRIFT_BOUND), DRIFT_BOUND)
