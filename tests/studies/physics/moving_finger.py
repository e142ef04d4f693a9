"""What a quiet finger that slides feels of a click, made for where it is and for where it will be. SIMULATED.

    python -m tests.studies.physics.moving_finger reference-a --table reference-a.nc

Of two fingers at random places one comes down and feels a click; the other is quiet and slides evenly, either way. Its
digitizer reports each 8 ms, a tenth of a millimetre beside the place. The run's own player places the fingers. The
click is then evaluated on sampled plants with the finger where it really is at the click's peak.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from engine.device import Device
from engine.effects.effect_player import EffectPlayer
from engine.effects.rules import DEFAULT_EFFECTS
from engine.table import Clicks, Table
from engine.touch import Placement, Touch
from precompute.clicks import DEFAULT_OPTIONS, ClickOptions, ClickSolver
from precompute.sampling.placements import Anywhere, random_placements
from tactable.shipped import find_device
from tests.studies.options import read_options
from tests.studies.physics.anywhere import TOLERANCE_M, contrast_cells, kept_share

PEAK_NS, LINE_NS = 27_000_000, 1_000_000  # median time of a click's peak in the tables of bars; a PLAY at 921 600 bit/s
PERIOD_MS, NOISE_M = 8, 1e-4


def made_for(
    device: Device, felt_m: float, quiet_m: float, m_per_s: float, noise_m: Sequence[float], ahead_ns: int
) -> Placement:
    """What the player places when the felt finger comes down, the quiet one being at `quiet_m` by then."""
    player = EffectPlayer(DEFAULT_EFFECTS)
    player.change_bar((), device.surface.corner_m)
    player.ahead_ns = ahead_ns
    for back, beside_m in zip(range(len(noise_m) - 1, -1, -1), noise_m, strict=True):
        at_m = float(np.clip(quiet_m - m_per_s * back * PERIOD_MS / 1000 + beside_m, 0, device.surface.length_m))
        felt = [Touch(2, felt_m, None)] * (back == 0)
        player.take_touches([Touch(1, at_m, None), *felt], 10**9 - back * PERIOD_MS * 1_000_000)
    assert player.wanted.placement is not None
    return player.wanted.placement


Levels = dict[float, dict[str, list[tuple[float, float]]]]
"""For each speed, m/s, and way: (felt 5 %, quiet 95 %) in dB of every placement."""


def compare_moving(
    device: Device,
    wanted: Anywhere,
    speeds_m_per_s: Sequence[float],
    options: ClickOptions = DEFAULT_OPTIONS,
    tabulated: Clicks | None = None,
) -> Levels:
    """Play clicks at random placements, the quiet finger sliding at each of the speeds."""
    solver = ClickSolver(device, replace(options, tolerance_m=TOLERANCE_M))
    random, found = np.random.default_rng(wanted.seed), Levels()
    for number, placement in enumerate(random_placements(device, wanted)):
        felt_m, quiet_m = (placement.position_m[places[0]].real for places in (placement.felt, placement.quiet))
        noise_m = random.uniform(-NOISE_M, NOISE_M, 8).tolist()
        for speed in speeds_m_per_s:
            m_per_s = speed * (1 - 2 * (number % 2))
            for way, ahead_ns in (("where it is", 0), ("where it will be", PEAK_NS + LINE_NS)):
                placed = made_for(device, felt_m, quiet_m, m_per_s, noise_m, ahead_ns)
                if len(placed.position_m) < 2:
                    continue
                made = solver.solve(placed)
                waveforms = {"made": (made.waveform.T, made.peak_s)}
                own = None if tabulated is None else tabulated.at(tabulated.places.key(placed))
                if own is not None:
                    waveforms["table"] = own.waveform.T, own.peak_s
                for key, (waveform, peak_s) in waveforms.items():
                    really_m = float(np.clip(quiet_m + m_per_s * (peak_s + 1e-9 * LINE_NS), 0, device.surface.length_m))
                    if abs(really_m - felt_m) < 0.015:  # it would be under the felt finger
                        continue
                    figures = solver.evaluate(Placement.on(device, [felt_m], [really_m]), waveform)
                    assert figures.quiet is not None
                    levels = found.setdefault(speed, {}).setdefault(f"{key}, {way}", [])
                    levels.append((figures.felt.low_db, figures.quiet.high_db))
    return found


def describe(found: Levels) -> list[str]:
    """Rows of a table: speed, way, percentiles of the contrast, felt and quiet, shares."""
    rows = [
        "| speed, mm/s | click | contrast (5, 50 %), dB | quiet (50, 95 %), dB | felt ≥ 14 and quiet ≤ 1; ≤ 6 dB |",
        "|---|---|---|---|---|",
    ]
    for speed, ways in found.items():
        for way, pairs in ways.items():
            felt_db, quiet_db = np.array(pairs).T
            kept = "; ".join(f"{100 * kept_share(felt_db, quiet_db, most):.0f} %" for most in (1, 6))
            rows.append(f"| {1e3 * speed:g} | {way} ({len(pairs)}) | {contrast_cells(pairs)} | {kept} |")
    return rows


def main() -> None:
    """Compare at random placements and some speeds."""
    asked = read_options(__doc__, device=str, placements=60, table="", speeds="0,50,100,200")
    device, tabulated = find_device(asked.device), None
    if asked.table:
        with Table.open(asked.table, device=device) as table:
            tabulated = table.clicks
    speeds = [float(each) / 1e3 for each in asked.speeds.split(",")]
    found = compare_moving(device, Anywhere(placements=asked.placements), speeds, tabulated=tabulated)
    print("\n".join(describe(found)))


if __name__ == "__main__":
    main()
