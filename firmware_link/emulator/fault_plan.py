"""Plan of injected faults, parsed from a text such as `bit_errors=1e-5,drop=0.01,stall=0.3s@5s,reboot@12s`."""

import difflib
import re
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from enum import StrEnum
from typing import Any

from firmware_link.protocol.link_errors import LinkError

_US = {"us": 1, "ms": 1_000, "s": 1_000_000}
_TIME = re.compile(r"(?P<number>[0-9.]+(?:e-?[0-9]+)?)(?P<unit>us|ms|s)")
PPB_PER_PPM = 1_000
_MOST_BAUD, _MOST_PPM, _LONGEST_S = 1_000_000_000, 100_000, 86_400


class FaultPlanError(LinkError):
    """The text is not a fault plan; the message says the key, the value and what was expected."""


class TimedKind(StrEnum):
    """Kinds of faults that begin at a time."""

    STALL = "stall"
    HALF_OPEN = "half_open"
    HANG_UP = "hang_up"
    REBOOT = "reboot"


@dataclass(frozen=True)
class TimedFault:
    """A fault that begins at a time and lasts for a while, once or each `period_us`."""

    kind: TimedKind
    start_us: int
    duration_us: int
    period_us: int | None

    def begins_us(self, since_us: int) -> int | None:
        """Time of the next beginning, at `since_us` or later; None after the last."""
        if since_us <= self.start_us:
            return self.start_us
        if self.period_us is None:
            return None
        return self.start_us + -(-(since_us - self.start_us) // self.period_us) * self.period_us

    def ends_us(self, time_us: int) -> int | None:
        """End of the fault that lasts at this time; None where none does."""
        elapsed_us = time_us - self.start_us
        if self.period_us is not None and elapsed_us >= 0:
            elapsed_us %= self.period_us
        return time_us - elapsed_us + self.duration_us if 0 <= elapsed_us < self.duration_us else None


def _parse_probability(value: str) -> float:
    probability = float(value)
    if not 0 <= probability <= 1:
        raise ValueError(value)
    return probability


def _parse_baud(value: str) -> int:
    if not (value.isascii() and value.isdecimal() and 0 < int(value) <= _MOST_BAUD):
        raise ValueError(value)
    return int(value)


def _parse_drift(value: str) -> int:
    if not value.endswith("ppm"):
        raise ValueError(value)
    ppm = float(value.removesuffix("ppm"))
    if not abs(ppm) <= _MOST_PPM:
        raise ValueError(value)
    return round(ppm * PPB_PER_PPM)


def _parse_switch(value: str) -> bool:
    if value:
        raise ValueError(value)
    return True


def _parse_time_us(value: str) -> int:
    time = _TIME.fullmatch(value)
    if time is None:
        raise ValueError(value)
    time_us = float(time["number"]) * _US[time["unit"]]
    if not time_us <= _LONGEST_S * _US["s"]:
        raise ValueError(value)
    return round(time_us)


def _fault(parse: Callable[[str], object], help_text: str, key: str = "", default: object = 0) -> Any:
    """A field that the text names by `key`, or by its own name."""
    return field(default=default, metadata={"parse": parse, "help": help_text, "key": key})


@dataclass(frozen=True)
class FaultPlan:
    """Faults by kind: probabilities of bits and frames in each direction, the pace of the line, and timed ones."""

    bit_errors: float = _fault(_parse_probability, "each bit is flipped with this probability: bit_errors=1e-5")
    drop: float = _fault(_parse_probability, "each frame is lost whole: drop=0.01")
    duplicate: float = _fault(_parse_probability, "each frame comes twice: duplicate=0.01")
    insert: float = _fault(_parse_probability, "1 to 8 random bytes come into a frame: insert=0.001")
    lose: float = _fault(_parse_probability, "1 to 8 bytes of a frame are missing: lose=0.001")
    burst: float = _fault(_parse_probability, "2 to 16 bytes of a frame are noise: burst=0.001")
    baud_hz: int = _fault(_parse_baud, "bits a second, ten a byte: baud=115200", "baud")
    delay_us: int = _fault(_parse_time_us, "everything comes later: delay=2ms", "delay")
    jitter_us: int = _fault(_parse_time_us, "and up to this much more: jitter=5ms", "jitter")
    drift_ppb: int = _fault(_parse_drift, "the device's clock is fast: drift=-80ppm", "drift")
    at_noise: bool = _fault(_parse_switch, "a modem prober speaks first at each opening: at_noise", default=False)
    timed: tuple[TimedFault, ...] = ()


_FIELDS = {fault.metadata["key"] or fault.name: fault for fault in fields(FaultPlan) if fault.metadata}
TIMED_HELP = {
    TimedKind.STALL: "nothing arrives, then all at once: stall=0.3s@5s, or each 5 s: stall=0.3s/5s",
    TimedKind.HALF_OPEN: "what the device says is lost: half_open=1s@3s",
    TimedKind.HANG_UP: "the port is gone and comes again under a new name: hang_up=1s@8s",
    TimedKind.REBOOT: "the device loses power for so long: reboot=0.5s@12s, or reboot@12s",
}


def parse_fault_plan(text: str) -> FaultPlan:
    """The plan of a text; raises FaultPlanError naming the key, the value and the remedy."""
    values: dict[str, Any] = {}
    timed: list[TimedFault] = []
    for item in filter(None, (part.strip() for part in text.split(","))):
        key = re.split("[=@/]", item, maxsplit=1)[0].strip()
        rest = item[len(key) :].strip()
        if key not in fault_help():
            raise FaultPlanError(f"fault {key!r} is unknown{_nearest(key)}; there are {', '.join(fault_help())}")
        if key in values:
            raise FaultPlanError(f"fault {key!r} is given twice: give it once")
        try:
            if key in _FIELDS:
                values[key] = _FIELDS[key].metadata["parse"](rest.removeprefix("=").strip())
            else:
                timed.append(_parse_timed(TimedKind(key), rest))
        except ValueError as error:
            raise FaultPlanError(f"fault {item!r} is not understood; write it as in: {fault_help()[key]}") from error
    return FaultPlan(**{_FIELDS[key].name: value for key, value in values.items()}, timed=tuple(timed))


def fault_help() -> dict[str, str]:
    """Help text for each key, with an example."""
    plain = {key: fault.metadata["help"] for key, fault in _FIELDS.items()}
    return plain | {kind.value: TIMED_HELP[kind] for kind in TimedKind}


def _nearest(key: str) -> str:
    near = difflib.get_close_matches(key, fault_help(), n=1)
    return f" (did you mean {near[0]!r}?)" if near else ""


def _parse_timed(kind: TimedKind, rest: str) -> TimedFault:
    timed = re.fullmatch(r"(?:=(?P<duration>[^@/]+))?(?P<mark>[@/])(?P<time>[^@/]+)", rest)
    if timed is None or (timed["duration"] is None and kind is not TimedKind.REBOOT):
        raise ValueError(rest)
    duration_us = 0 if timed["duration"] is None else _parse_time_us(timed["duration"])
    time_us = _parse_time_us(timed["time"])
    period_us = time_us if timed["mark"] == "/" else None
    if period_us is not None and duration_us >= period_us:
        raise ValueError(rest)
    return TimedFault(kind, time_us, duration_us, period_us)
