"""The option --hammer of `measure`: taps at places of a surface, to responses per newton or to modes."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from base.files import write_text
from base.points import point_text
from engine.device import Device
from engine.device.quantity import QuantityError, read_point_on
from precompute.measurements.parameters import with_changes
from precompute.measurements.simulate import even_places
from tactable.cli import options
from tactable.cli.console import note, say, show
from tactable.cli.measure import ask
from tactable.measure.apparatus import ApparatusOptions
from tactable.measure.hammer import HammerOptions, open_taps, responses_text, tap_places
from tactable.measure.sensor import FORCE, REFERENCE
from tactable.measure.tap_bench import TapBench
from tactable.measure.taps import Tap


def tap_surface(
    device: Device,
    output: Path,
    modes: Path | None,
    bench: ApparatusOptions,
    where: dict[str, Any],
    frequency_hz: list[float] | None,
    as_json: bool,
) -> None:
    """Take taps and write what they show; `where` has the options --places, --sensor-at, --taps and --pause."""
    hz = device.sweep.frequency_hz if frequency_hz is None else np.array(frequency_hz)
    if any(path.suffix != ".csv" for path in (output, modes) if path is not None) or len(hz) < 2:
        raise options.OptionError("--hammer: give files that end in .csv, and --frequencies a range such as 60:300:1")
    try:
        fixed_m = read_point_on(where["sensor_at"], device.surface.corner_m)
    except QuantityError as wrong:
        raise options.OptionError(f"--sensor-at: {wrong}") from None
    places_m, pause_s = (
        even_places(device, where["places"]).tolist(),
        options.read_option("--pause", where["pause"], "s"),
    )
    chosen = HammerOptions(tuple(places_m), fixed_m, where["taps"], pause_s, bench.sensor_mass_kg)

    def tell(at_m: complex, taps: Sequence[Tap]) -> None:
        for tap in taps:
            if tap.faults:
                note(f"{point_text(at_m, 1, 'f')}: {tap.text}")

    made = None
    if bench.is_simulated:
        true = with_changes(device, bench.changes)
        made = TapBench(true, bench.flaws, bench.seed, fixed_m, bench.sensor_mass_kg)
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
