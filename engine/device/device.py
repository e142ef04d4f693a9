"""`Device`: one surface with everything on it, read from a description in TOML, and the fingerprint of its values."""

import hashlib
import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from html import escape
from pathlib import Path
from typing import Any

from base.points import point_text
from engine.device.description import (
    DeviceTable,
    check_bands,
    check_clamps,
    check_damping,
    check_electrodes,
    check_transfers,
    read_actuators,
    read_levels,
    read_limits,
    read_spread,
    read_sweep,
)
from engine.device.finger import FingerOrigin, read_finger
from engine.device.named_files import (
    names_files,
    shipped_names,
    shipped_path,
    text_with_threshold,
    text_with_values,
    with_files_inside,
)
from engine.device.parts import (
    Actuator,
    Bar,
    DeviceError,
    Finger,
    Limits,
    Spread,
    Surface,
    Sweep,
    TouchAxis,
    Uncertainty,
    Zone,
)
from engine.device.surface_description import read_surface, read_touch_axis, read_zones
from engine.device.threshold import DEFAULT, Threshold, read_threshold, shipped_threshold
from engine.device.toml_table import read_text
from engine.device.uncertainty import read_uncertainty

_PHYSICAL = re.compile(r"(bar|plate|actuator(\[\d+\])?|finger|spread)\.\w+")
_CHOSEN = ("bar.largest_element", "bar.damping_of", "plate.damping_of")


@dataclass(frozen=True, repr=False)
class Device:
    """One surface with its actuators, zones, finger, digitizer, sweep grid and limits; all points from its start."""

    name: str
    description: str
    surface: Surface
    actuators: tuple[Actuator, ...]
    zones: tuple[Zone, ...]
    zone_hysteresis_m: float
    finger: Finger
    finger_origin: FingerOrigin
    spread: Spread
    touch_axis: TouchAxis
    sweep: Sweep
    levels_db: tuple[float, ...]
    """Sensation levels that best rows are made for, rising; rows for full scale are always made too."""
    threshold: Threshold  # the detection threshold that every level is above
    limits: Limits
    inferred: tuple[str, ...]
    """Keys whose values are estimates, such as "bar.width": marked in the file, or absent and assumed."""
    uncertainty: Uncertainty | None  # uncertainty of the fitted values; None: the device was not calibrated
    text: str  # the text of the description

    @classmethod
    def read(cls, path: Path | str) -> "Device":
        """Read and validate a description in TOML. Raises DeviceError; OSError when there is no such file.

        >>> device = Device.read("my-bar.toml")
        >>> device.zone_names(range(3)), device.actuators[0].band_hz
        ('I, II, III', (60.0, 300.0))
        """
        return cls.parse(read_text(Path(path), DeviceError), str(path), Path(path).parent)

    @classmethod
    def parse(cls, text: str, source: str, folder: Path | None = None) -> "Device":
        """Validate the description `text`; `source` names it in errors. Raises DeviceError.

        `folder`: where the paths of files begin that the text names; None: it may name none.
        """
        top = DeviceTable.parse(text, source)
        if names_files(top.left):
            text = with_files_inside(text, source, folder)
            top = DeviceTable.parse(text, source)
        name, description = top.name("name"), top.sentence("description")
        threshold = read_threshold(top.take_value("threshold", DEFAULT), source)
        sweep = top.section("sweep", read_sweep)
        surface = read_surface(top, sweep)
        actuators = read_actuators(top, surface)
        check_damping(source, surface, actuators)
        check_clamps(source, surface, actuators)
        check_electrodes(source, actuators)
        check_transfers(source, actuators)
        finger, finger_origin = top.section("finger", lambda part: read_finger(part, sweep))
        zones, zone_hysteresis_m = top.section("zones", lambda part: read_zones(part, top, surface), default={})
        check_bands(source, actuators, sweep)
        uncertainty = None
        if "calibration" in top.left:
            uncertainty = top.section("calibration", lambda part: read_uncertainty(part, len(actuators)))
        spread = _named_truly(top.section("spread", read_spread, default={}))
        if isinstance(surface, Bar):
            widest = tuple(replace(each, clamp_m=each.clamp_m + spread.clamp_m) for each in actuators)
            check_clamps(f"{source}: with spread.clamp", surface, widest)
        device = cls(
            name=name,
            description=description,
            surface=surface,
            actuators=actuators,
            zones=zones,
            zone_hysteresis_m=zone_hysteresis_m,
            finger=finger,
            finger_origin=finger_origin,
            spread=spread,
            touch_axis=top.section("digitizer", lambda part: read_touch_axis(part, surface), default={}),
            sweep=sweep,
            levels_db=top.section("feel", read_levels, default={}),
            threshold=threshold,
            limits=top.section("limits", read_limits),
            inferred=tuple(top.inferred),
            uncertainty=uncertainty,
            text=text,
        )
        top.close()
        return device

    def with_values(self, values: Mapping[str, str | float | list[str]]) -> "Device":
        """The device with other values, by their keys in the file; marks of estimates stay as they are.

        Raises DeviceError for a key that the file does not have, and for a value that is not valid.

        >>> thinner = device.with_values({"bar.thickness": "0.7 mm", "actuator[1].mass": "9 g"})
        >>> f"{1e3 * thinner.bar.thickness_m:.1f} mm"
        '0.7 mm'
        """
        return Device.parse(text_with_values(self.text, values, self.name), self.name)

    def with_threshold(self, curve: str | Path) -> "Device":
        """The device with another threshold curve: a shipped one by its name, or a TOML file by its path.

        Raises DeviceError for a name that is not shipped, and for a file that is no curve.

        >>> device.with_threshold("android").threshold.name
        'android'
        """
        return Device.parse(text_with_threshold(self.text, curve, self.name), self.name)

    @property
    def bar(self) -> Bar:
        """The surface, where it is a bar. Raises DeviceError for a plate: what asks is for bars alone."""
        if not isinstance(self.surface, Bar):
            raise DeviceError(f"{self.name}: is a plate; this is for bars alone: give a device with [bar]")
        return self.surface

    def __repr__(self) -> str:
        parts = f"{point_text(self.surface.corner_m)}, {len(self.actuators)} actuators, {len(self.zones)} zones"
        return f"<Device {self.name}: {parts}, {len(self.estimated_values)} estimated values>"

    def _repr_html_(self) -> str:
        surface = self.surface
        zones = (f"{each.name} {point_text(each.start_m, 4)} to {point_text(each.stop_m, 4)}" for each in self.zones)
        parts = (
            f"{a.name} at {point_text(a.position_m, 4)}, {a.band_hz[0]:g} to {a.band_hz[1]:g} Hz"
            for a in self.actuators
        )
        rows = {
            surface.kind: " by ".join(map(_mm, (surface.length_m, surface.width_m, surface.thickness_m))),
            "actuators": "; ".join(parts),
            "zones": "; ".join(zones),
            "threshold": self.threshold.title,
            "estimated values": ", ".join(self.estimated_values) or "none",
        }
        shown = "".join(f"<tr><td>{escape(name)}</td><td>{escape(text)}</td></tr>" for name, text in rows.items())
        return f"<b>Device</b> {escape(self.name)}<table>{shown}</table>"

    @property
    def spread_text(self) -> str:
        """What clicks and drives are made for, in words: the name of the set of spreads, and its values."""
        spread = self.spread
        shares = ("stiffness", "mass", "length", "damping", "gain")
        parts = [f"{key} {100 * getattr(spread, key):g} %" for key in shares if getattr(spread, key)]
        if spread.clamp_m and isinstance(self.surface, Bar):
            parts.append(f"bolts that clamp up to {1e3 * spread.clamp_m:g} mm more")
        if spread.delay_s:
            parts.append(f"channels \N{PLUS-MINUS SIGN}{1e6 * spread.delay_s:g} \N{MICRO SIGN}s")
        people = f"fingers as people's (95 % within a factor of {self.finger.spread:g})"
        parts.append(people if spread.finger is None else f"finger \N{PLUS-MINUS SIGN}{100 * spread.finger:g} %")
        parts.append(f"within {1e3 * spread.finger_position_m:g} mm")
        if spread.speed_m_per_s:
            parts.append(f"speed known to {1e3 * spread.speed_m_per_s:g} mm/s")
        return f"{spread.name or 'spread of the device file'}: {', '.join(parts)}"

    @property
    def estimated_values(self) -> tuple[str, ...]:
        """Those keys of `inferred` that are physical values of bar, actuators and finger, or how well these are known.

        The others are choices, such as the grid of the sweep, which nobody could measure.
        """
        return tuple(key for key in self.inferred if _PHYSICAL.fullmatch(key) and key not in _CHOSEN)

    @property
    def fingerprint(self) -> str:
        """SHA-256 (hex) of every value that the model or the engine uses; descriptions and marks do not count.

        The uncertainty of a calibration counts, since worst cases are taken over it; its date and origin do not.
        """
        idle = {"description", "inferred", "text", "finger_origin"}
        if self.uncertainty is None:
            idle.add("uncertainty")
        values = {k: v for k, v in asdict(self).items() if k not in idle}
        values["threshold"] = self.threshold.values
        surface = values[self.surface.kind] = values.pop("surface")
        del values["spread"]["name"]
        # What a file from before these keys has by default does not count, so that it keeps its fingerprint.
        if surface["damping_of"] == "bar":
            del surface["damping_of"]
        if self.sweep.is_stored:
            del values["sweep"]["is_stored"]
        for key, default in (("silence_s", None), ("debounce_s", 0.0), ("latency_s", 0.0), ("across", None)):
            if values["touch_axis"][key] == default:
                del values["touch_axis"][key]
        for key in ("length", "damping", "gain", "delay_s", "clamp_m", "speed_m_per_s"):
            if not values["spread"][key]:
                del values["spread"][key]
        for actuator in values["actuators"]:
            for key in ("transfer", "electrodes", "moving_mass_kg", "is_force", "clamp_m", "delay_s"):
                if not actuator[key]:
                    del actuator[key]
        if values["threshold"] == shipped_threshold(DEFAULT).values:
            del values["threshold"]
        return hashlib.sha256(json.dumps(_rounded(values), sort_keys=True).encode()).hexdigest()

    def zone_names(self, indices: Iterable[int]) -> str:
        """Names of zones joined as "I, III, V"."""
        return ", ".join(self.zones[i].name for i in indices)

    def zone_index(self, name: str) -> int:
        """Index of the zone called `name`; raises DeviceError with the known names."""
        names = [zone.name for zone in self.zones]
        if name not in names:
            raise DeviceError(f"{self.name}: there is no zone {name!r}; zones are {', '.join(names)}")
        return names.index(name)


def _named_truly(spread: Spread) -> Spread:
    """The spread, whose name says so where it differs from the shipped set of that name."""
    is_other = spread.name in shipped_names("spread") and spread != _shipped_spread(spread.name)
    return replace(spread, name=f"{spread.name}, changed") if is_other else spread


@lru_cache(maxsize=8)
def _shipped_spread(name: str) -> Spread:
    path = shipped_path("spread", name)
    return read_spread(DeviceTable.parse(read_text(path, DeviceError), str(path)))


def _mm(metres: float) -> str:
    return f"{1e3 * metres:.4g} mm"


def _rounded(value: Any) -> Any:
    """Round floats to 12 digits: '27.94 cm' and '279.4 mm' differ in the last bit and are the same device."""
    if isinstance(value, dict):
        return {key: _rounded(part) for key, part in value.items()}
    if isinstance(value, tuple | list):
        return [_rounded(part) for part in value]
    if isinstance(value, complex):
        return [_rounded(value.real), _rounded(value.imag)]
    return float(f"{value:.12g}") + 0.0 if isinstance(value, float) else value
