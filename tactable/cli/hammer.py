"""The option --hammer of `measure`: taps at places of a surface, to responses per newton or to modes."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from base.files import write_text
from base.points import point_text
from engine.device import Device
from engine.device.quantity import QuantityError, read_words
from precompute.measurements.model import even_places
from precompute.measurements.parameters import with_changes
from precompute.measurements.types import is_outside
from tactable.cli import options
from tactable.cli.console import note, say, show
from tactable.cli.measure import ask
from tactable.measure.apparatus import ApparatusOptions
from tactable.measure.sensor import FORCE, REFERENCE
from tactable.measure.tapping.hammer import HammerOptions, TapBench, open_taps, responses_text, tap_places
from tactable.measure.tapping.taps import Tap

_WORDS = {"at": ("fixed_m", "point"), "taps": ("taps", "number"), "pause": ("pause_s", "s")}
_MOST_TAPS, _LONGEST_PAUSE_S = 100, 600.0


def tap_surface(
    device: Device,
    output: Path,
    modes: Path | None,
    bench: ApparatusOptions,
    places: int,
    spec: str,
    frequency_hz: list[float] | None,
    as_json: bool,
) -> None:
    """Measure by taps of a hammer at `places` places, and write responses or modes; `spec` is the text of --hammer."""
    hz = device.sweep.frequency_hz if frequency_hz is None else np.array(frequency_hz)
    if any(path.suffix != ".csv" for path in (output, modes) if path is not None) or len(hz) < 2:
        raise options.OptionError("--hammer: give files that end in .csv, and --frequencies a range such as 60:300:1")
    chosen = _read_spec(spec, device, tuple(even_places(device, places).tolist()), bench.sensor_mass_kg)

    def tell(at_m: complex, taps: Sequence[Tap]) -> None:
        for tap in taps:
            if tap.faults:
                note(f"{point_text(at_m, 1, 'f')}: {tap.text}")

    made = None
    if bench.is_simulated:
        true = with_changes(device, bench.changes)
        made = TapBench(true, bench.flaws, bench.seed, chosen.fixed_m, bench.sensor_mass_kg)
    with open_taps(device, bench.sensor, chosen, made, ask) as (form, record):
        if modes is not None and FORCE not in form.channels:
            raise options.OptionError(f"--modes {modes}: without a force channel {output} has the modes; leave it out")
        tapped = tap_places(form, chosen, record, tell)
    counts = [len(taps) for taps in tapped.taps]
    written = [str(path) for path in (output, modes) if path is not None]
    simulated = "SIMULATED " if form.is_simulated else ""
    lines = [f"{simulated}{device.name}: {sum(counts)} good taps at {len(counts)} places"]
    summary: dict[str, Any] = {"channels": form.channels, "simulated": form.is_simulated, "taps": counts}
    if FORCE in form.channels:
        found, error = tapped.responses(device, hz)
        write_text(output, responses_text(found, device, f"{simulated}tactable measure {device.name} --hammer"))
        summary |= {
            "responses": len(found),
            "median_error": None if np.isnan(error).all() else float(np.nanmedian(error)),
        }
        lines += [f"{len(found)} responses per newton, standard error (median) {100 * np.median(error):.2g} %"]
        if modes is not None:
            write_text(modes, tapped.modes(device, hz, str(output)))
    else:
        write_text(output, tapped.modes(device, hz, bench.sensor))
        if REFERENCE not in form.channels:
            lines += ["no force channel and no reference: modes have frequencies and damping ratios, and no shapes"]
    lines += [f"written: {', '.join(written)}"]
    show(summary | {"output": written}, as_json, lambda *_: say("\n".join(lines)))


def _read_spec(spec: str, device: Device, places_m: tuple[complex, ...], mass_kg: float) -> HammerOptions:
    """The text of --hammer, such as "at=25mm,taps=3,pause=4s". Raises OptionError."""
    try:
        found = {"taps": 3.0, "pause_s": 4.0} | read_words(spec, _WORDS)
    except QuantityError as wrong:
        raise options.OptionError(f"--hammer: {wrong}; expected such as at=25mm,taps=3,pause=4s") from None
    taps, pause_s, fixed_m = round(found["taps"]), found["pause_s"], found.get("fixed_m")
    if fixed_m is None or is_outside(np.array([fixed_m]), device.surface.corner_m).any():
        raise options.OptionError(f"--hammer {spec!r}: expected at=PLACE, the place of what stays on {device.name}")
    if not (1 <= taps <= _MOST_TAPS and 0 < pause_s <= _LONGEST_PAUSE_S):
        raise options.OptionError(f"--hammer {spec!r}: expected 1 to {_MOST_TAPS} taps, {_LONGEST_PAUSE_S:g} s at most")
    return HammerOptions(places_m, fixed_m, taps, pause_s, mass_kg)
