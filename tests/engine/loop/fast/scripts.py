"""Scripts of fingers for the compiled step: who touches where and when, as reports of a digitizer with four slots."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from engine.device import Device
from engine.device.parts import Plate, TouchAcross, Zone
from engine.effects.rules import Effect, Rule, Segment, Trigger, click
from engine.table import Clicks
from engine.touch.placement import Key
from firmware_link.protocol.basis import Basis, BasisSet
from tests.engine.loop import rig
from tests.engine.loop.rig import DEVICE, SLOTS
from tests.engine.made_table import LEVEL_DB, basis_of, click_of, made_clicks, places_of
from tests.tools.virtual import MS

LOUD_DB = LEVEL_DB + 6.0
_HELD = Effect("held", (Segment(None, LEVEL_DB),))
_LATE = Effect("late", (Segment(40 * MS, None), Segment(30 * MS, LOUD_DB)))
_CLICK_THEN_HELD = Effect("click, then held", (Segment(None, LEVEL_DB, is_click=True), Segment(None, LEVEL_DB)))
_EFFECTS = (click(LEVEL_DB), click(LOUD_DB), _CLICK_THEN_HELD, _HELD, _LATE)
# Most rules bring clicks, which the compiled step answers.
_CHANCES = (0.4, 0.3, 0.1, 0.1, 0.1)
_TRIGGERS = tuple(Trigger)
_CHANCES_OF_TRIGGERS = (0.5, 0.1, 0.3, 0.1)  # touch, hold, lift, drag

Fingers = Mapping[int, float]
"""Places by contact id, as fractions of the bar; how far across a plate follows from both."""


def device_with_gaps() -> Device:
    """The published bar with two zones, between which there are gaps."""
    zones = "".join(
        f'[[zone]]\nname = "{name}"\nstart = "{start} mm"\nstop = "{stop} mm"\n\n'
        for name, start, stop in (("I", 20, 90), ("II", 150, 240))
    )
    text = DEVICE.text.replace("count = 5 # equal; or [[zone]] tables with name, start, stop\n", "")
    text = text.replace('inferred = ["count", "hysteresis"]\n', 'inferred = ["hysteresis"]\n\n' + zones)
    return Device.parse(text, "bar.toml")


def plate_device() -> Device:
    """A plate with a gap between its zones, whose digitizer lies along Y, reaches beyond it, and is flipped across."""
    lower_m = (0j, 0.07 + 0.05j), (0.07 + 0j, 0.15 + 0.05j)
    corners_m = (*lower_m, (0.05j, 0.06 + 0.09j), (0.08 + 0.05j, 0.15 + 0.09j))
    across = TouchAcross(flip=True, start_margin_m=0.0, end_margin_m=-0.01, active_length_m=None)
    left, right = DEVICE.actuators
    return replace(
        DEVICE,
        surface=Plate(0.15, 0.09, 1e-3, 70e9, 2500.0, 0.23, 0.0, 0.0),
        actuators=(replace(left, position_m=0.02 + 0.02j), replace(right, position_m=0.13 + 0.07j)),
        zones=tuple(Zone(name, *ends) for name, ends in zip("ABCD", corners_m, strict=True)),
        touch_axis=replace(DEVICE.touch_axis, axis="y", start_margin_m=-0.01, across=across),
    )


def varied_clicks(device: Device, missing: int = 9) -> Clicks:
    """Clicks of all placements of one and two fingers, of two sets and several fraction bits; some are missing."""
    places, actuators = places_of(device), len(device.actuators)
    codes = range(2 * places.count)
    keys: list[Key] = [(code,) for code in codes if code % 2]
    keys += [(one, other) for one in codes for other in codes if one // 2 < other // 2 and (one % 2 or other % 2)]
    del keys[missing::missing]
    few = basis_of(actuators, 121)
    more = BasisSet(
        np.tile(basis_of(actuators, 81).sets[0].functions, (2, 1)), np.arange(2 * actuators, dtype=np.uint8) % 2
    )
    basis = Basis(few.sample_rate_hz, (*few.sets, more))
    random = np.random.default_rng(3)
    clicks = [
        replace(
            click_of(device, places.placement(key), level_db=float(random.uniform(15.0, 40.0))),
            basis=basis,
            basis_set=row % 2,
            weights=random.integers(-9000, 9000, len(basis.sets[row % 2].actuators)).astype(np.int16),
            fraction_bits=1 + row % 14,
        )
        for row, key in enumerate(keys)
    ]
    return made_clicks(device, clicks)


def report(fingers: Fingers, lifted: Sequence[int] = (), palms: Collection[int] = ()) -> bytes:
    """One frame of up to four contacts in one report."""
    touches = [(contact, complex(place, (0.37 * contact + 0.9 * place) % 1)) for contact, place in fingers.items()]
    return rig.report(*touches, lifted=lifted, palms=palms)


def random_frames(random: np.random.Generator, steps: int) -> list[tuple[float, bytes]]:
    """Fingers that come, slide, jump, jitter and lift; of up to four, mostly one or two."""
    time_s, fingers, frames = 0.0, dict[int, float](), list[tuple[float, bytes]]()
    pause_s, speeds = 0.0, dict[int, float]()  # of a finger, in bars per second
    palms, has_palms = set[int](), random.random() < 0.2
    for _ in range(steps):
        before = dict(fingers)
        wanted = int(random.choice(SLOTS + 1, p=(0.15, 0.35, 0.3, 0.1, 0.1)))
        for contact in list(fingers):
            fingers[contact] = float(np.clip(fingers[contact] + speeds[contact] * pause_s, 0, 1))
            if random.random() < 0.2:
                # A digitizer unit is 0.28 mm: some moves are jitter, some are followed.
                fingers[contact] = float(
                    np.clip(fingers[contact] + random.choice((-0.1, -0.003, -0.001, 0.001, 0.05)), 0, 1)
                )
        while len(fingers) > wanted:
            del fingers[int(random.choice(list(fingers)))]
        while len(fingers) < wanted:
            near = [place + random.uniform(-0.04, 0.04) for place in fingers.values()]
            place = near[0] if near and random.random() < 0.2 else random.uniform(-0.0, 1.0)
            contact = int(random.choice([each for each in range(1, 9) if each not in fingers]))
            fingers[contact] = float(np.clip(place, 0, 1))
            speeds[contact] = float(random.choice((0.0, 0.1, -0.4, 1.0, 3.0)))
        if fingers and has_palms and random.random() < 0.2:
            palms ^= {int(random.choice(list(fingers)))}
        frames.append((time_s, report(fingers, [contact for contact in before if contact not in fingers], palms)))
        pause_s = float(random.choice((0.002, 0.008, 0.025, 0.06)))
        time_s += pause_s
    return [*frames, (time_s + 0.1, report({}, list(fingers)))]


def random_rules(random: np.random.Generator, device: Device) -> tuple[Rule, ...]:
    """Up to four rules by zone, by region, and anywhere, mostly on touches and lifts."""
    zones = range(len(device.zones))
    return tuple(
        Rule(
            _TRIGGERS[int(random.choice(len(_TRIGGERS), p=_CHANCES_OF_TRIGGERS))],
            _EFFECTS[int(random.choice(len(_EFFECTS), p=_CHANCES))],
            zones=frozenset(random.choice(zones, 1 + int(random.integers(2))).tolist()) if where == "zones" else None,
            region_m=_region(random, device.surface.corner_m) if where == "region" else None,
            after_ns=20 * MS,
            every_m=0.01,
        )
        for where in random.choice(("zones", "region", "anywhere"), 1 + int(random.integers(4))).tolist()
    )


def _region(random: np.random.Generator, corner_m: complex) -> tuple[complex, complex]:
    start_m, stop_m = sorted(random.uniform(0, corner_m.real, 2).tolist())
    if not isinstance(corner_m, complex):
        return start_m, stop_m
    low_m, high_m = sorted(random.uniform(0, corner_m.imag, 2).tolist())
    return complex(start_m, low_m), complex(stop_m, high_m)
