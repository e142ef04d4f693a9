"""The shipped devices, variations of them, and a third one at random: what the model's laws are checked on."""

import re
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from engine.device import Actuator, Device, Zone
from engine.device.parts import Plate
from tests.quick import first_quick

SHIPPED = Path(__file__).parents[2] / "tables" / "devices"
RANDOM = "random-20230247606"


@cache
def shipped(name: str) -> Device:
    return Device.read(SHIPPED / f"{name}.toml")


def reference_text(changes: Mapping[str, str]) -> str:
    """The description of reference-a with these parts replaced, each of which must be there."""
    text = (SHIPPED / "reference-a.toml").read_text(encoding="utf-8")
    for old, new in changes.items():
        assert old in text, old
        text = text.replace(old, new)
    return text


def every_device() -> dict[str, Device]:
    """Both shipped devices and a random one, by name."""
    devices = (shipped("reference-a"), shipped("reference-d"), random_device(int(RANDOM.removeprefix("random-"))))
    return {device.name: device for device in devices}


def on_each(devices: Mapping[str, Device]) -> pytest.MarkDecorator:
    """The argument `device` of a test: the random one, which is like no other, and with the long tests all of them."""
    cases = devices.items()
    values = [pytest.param(device, id=name, marks=() if name == RANDOM else pytest.mark.long) for name, device in cases]
    return pytest.mark.parametrize("device", values)


@cache
def other_bars() -> dict[str, Device]:
    """Reference-a as bars of other materials and sizes, read from a description, by name."""
    return {
        "acrylic 500 x 0.8 mm": other_bar(("500 mm", "0.8 mm", "3.2 GPa", "1190 kg/m^3")),
        "acrylic 250 x 2 mm": other_bar(("250 mm", "2 mm", "3.2 GPa", "1190 kg/m^3")),
        "steel 280 x 3 mm": other_bar(("280 mm", "3 mm", "200 GPa", "7850 kg/m^3")),
        "steel 100 x 3 mm": other_bar(("100 mm", "3 mm", "200 GPa", "7850 kg/m^3")),
        "acrylic 500 x 0.8 mm to 600 Hz": other_bar(("500 mm", "0.8 mm", "3.2 GPa", "1190 kg/m^3"), stop="600 Hz"),
    }


def other_bar(bar: tuple[str, str, str, str], stop: str = "300 Hz", **values: str) -> Device:
    """Reference-a with this length, thickness, modulus and density of its bar, swept to `stop`, and other values."""
    text = reference_text({'stop = "300 Hz"': f'stop = "{stop}"'})
    keys = ("length", "thickness", "youngs_modulus", "density")
    for key, value in [*zip(keys, bar, strict=True), *values.items()]:
        text, count = re.subn(rf'^{key} = "[^"]*"', f'{key} = "{value}"', text, flags=re.MULTILINE)
        assert count
    return Device.parse(text, " ".join([*bar, stop]))


def random_device(seed: int, actuators: int = 3) -> Device:
    """REF-A with other dimensions, `actuators` unequal actuators and four unequal zones that leave gaps."""
    random = np.random.default_rng(seed)
    base = shipped("reference-a")
    bar = replace(
        base.bar,
        length_m=random.uniform(0.1, 0.6),
        width_m=random.uniform(0.01, 0.04),
        thickness_m=random.uniform(0.7e-3, 3e-3),
        youngs_modulus_pa=random.uniform(60e9, 210e9),
        mass_damping_per_s=random.uniform(0.1, 2.0),
    )
    places = bar.length_m * np.sort(random.choice(np.arange(2, 99), actuators, replace=False)) / 100
    edges = bar.length_m * np.sort(random.choice(np.arange(1, 100), 8, replace=False)) / 100
    return replace(
        base,
        name=f"random-{seed}",
        surface=bar,
        actuators=tuple(_random_actuator(random, f"actuator {i}", place) for i, place in enumerate(places.tolist())),
        zones=tuple(Zone(f"zone {i}", *pair) for i, pair in enumerate(edges.reshape(4, 2).tolist())),
    )


def _random_actuator(random: np.random.Generator, name: str, position_m: float) -> Actuator:
    return Actuator(
        name=name,
        position_m=position_m,
        stiffness_n_per_m=random.uniform(5e3, 5e4),
        damping_n_s_per_m=random.uniform(0.02, 0.5),
        mass_kg=random.uniform(0.0, 0.02),
        full_scale_m=random.uniform(0.2e-6, 2e-6),
        band_hz=(60.0, 300.0),
    )


def with_bar(device: Device, **changes: Any) -> Device:
    return replace(device, surface=replace(device.bar, **changes))


def with_actuators(device: Device, **changes: Any) -> Device:
    """The device with the same other values at every actuator."""
    return replace(device, actuators=tuple(replace(actuator, **changes) for actuator in device.actuators))


def with_inertial(device: Device) -> Device:
    """The device with a moving mass of 2 g on its first actuator, driven by a force; alone it resonates at 123 Hz."""
    first, *others = device.actuators
    inertial = replace(
        first,
        stiffness_n_per_m=1200.0,
        damping_n_s_per_m=0.1,
        mass_kg=1e-3,
        moving_mass_kg=2e-3,
        full_scale_m=0.05 / 1200,
        is_force=True,
    )
    return replace(device, name=f"{device.name} inertial", actuators=(inertial, *others))


def damped_as_assembly(device: Device) -> Device:
    """The device whose damping acts on the springs and masses of the actuators too."""
    return replace(with_bar(device, damping_of="assembly"), name=f"{device.name}, assembly damped")


def mirrored(device: Device) -> Device:
    """The device seen from behind: places x become length - x; actuators keep their order, zones turn round."""
    length_m = device.bar.length_m
    actuators = tuple(replace(actuator, position_m=length_m - actuator.position_m) for actuator in device.actuators)
    zones = tuple(Zone(zone.name, length_m - zone.stop_m, length_m - zone.start_m) for zone in reversed(device.zones))
    return replace(device, actuators=actuators, zones=zones)


def tablet() -> Device:
    """A plate of glass on three actuators, with two zones that leave a gap."""
    bar, actuator = shipped("reference-a"), shipped("reference-a").actuators[0]
    plate = Plate(0.3, 0.18, 1.1e-3, 70e9, 2500.0, 0.23, bar.bar.mass_damping_per_s, bar.bar.stiffness_damping_s)
    places_m = 0.03 + 0.025j, 0.27 + 0.035j, 0.15 + 0.15j
    return replace(
        bar,
        name="tablet",
        surface=plate,
        actuators=tuple(
            replace(actuator, name=name, position_m=at, full_scale_m=4e-6)
            for name, at in zip("abc", places_m, strict=True)
        ),
        zones=(Zone("I", 0j, 0.14 + 0.18j), Zone("II", 0.16 + 0j, 0.3 + 0.18j)),
    )


def coarsely_swept(device: Device) -> Device:
    """The device with a sweep of 4 Hz, which solves faster."""
    return replace(device, sweep=replace(device.sweep, step_hz=4.0))


def three_actuators() -> Device:
    """A random device: a band of its own for each actuator, less than full scale allowed, levels beyond its reach."""
    device = random_device(20230247606)
    bands = ((60.0, 300.0), (60.0, 240.0), (85.0, 300.0))
    return replace(
        device,
        actuators=tuple(replace(one, band_hz=band) for one, band in zip(device.actuators, bands, strict=True)),
        levels_db=(10.0, 25.0, 40.0),
        limits=replace(device.limits, amplitude=0.8),
    )


any_device = on_each(every_device())

BARS = {name: shipped(name) for name in ("reference-a", "reference-d", "reference-t")} | other_bars()
any_bar = pytest.mark.parametrize("device", first_quick(BARS.values(), len(BARS) - 1), ids=BARS)
