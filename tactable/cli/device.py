"""Commands `modes` and `check`: what a device file says of its surface, before a table is built."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from rich.console import Console
from rich.table import Table as Grid
from typer import Option

from base.plain import to_plain
from base.points import json_of, point_of_json, point_text
from tactable.cli import options
from tactable.cli.console import say, show
from tactable.shipped import find_device, find_device_file

if TYPE_CHECKING:
    from engine.device import Device
    from precompute.model.modal import Mode

_CHECKED_MODES = 6  # shipped bars have 4 to 7 below twice their band; a line for each
_LEAST_RATIO = 1e-6
_THRESHOLD_KEYS = ("name", "title", "source", "frequency_hz", "measured_hz", "people_db")


def modes(
    device_name: options.DeviceArgument,
    fingers: Annotated[
        str, Option("--finger", help="Where fingers lie: zones or positions, as III,35mm. Default: the middle.")
    ] = "",
    up_to: Annotated[str, Option(help="Highest frequency.")] = "1 kHz",
    output: Annotated[
        Path | None, Option("-o", "--output", help="A picture of the shapes; ends in .png, .svg or .pdf.")
    ] = None,
    as_json: options.AsJson = False,
) -> None:
    """List the modes of a bar or a plate, untouched and under a finger.

    Each has its frequency, its damping ratio, and the time in which its amplitude falls to 1/e.
    """
    from precompute.model.modal import compute_modes, seen_points
    from tactable.explain.words import estimates_text
    from tactable.figures.picture_file import outputs_of, write_outputs

    outputs = outputs_of([] if output is None else [output])
    device = find_device(device_name)
    at_m = list(options.read_placement(device, fingers, "").position_m) if fingers else [device.surface.corner_m / 2]
    limit_hz = options.read_option("--up-to", up_to, "Hz")
    position_m = seen_points(device)
    untouched, touched = (compute_modes(device, position_m, limit_hz, at) for at in ((), at_m))
    if not untouched and not touched:
        raise options.OptionError(f"--up-to: {device.name} has no mode up to {up_to}; give a higher frequency")
    found = {
        "device": device.name,
        "estimated": list(device.estimated_values),
        "estimates": estimates_text(device),
        "finger_m": [json_of(each_m) for each_m in at_m],
        "untouched": [_mode_json(mode) for mode in untouched],
        "with_finger": [_mode_json(mode) for mode in touched],
    }
    if output is not None:
        from tactable.figures.mode_picture import plot_modes

        write_outputs(plot_modes(device, position_m, at_m, untouched, touched), outputs)
    show(found, as_json, _print_modes)
    if output is not None and not as_json:
        say(f"written: {output}")


def _mode_json(mode: "Mode") -> Any:
    return to_plain({key: getattr(mode, key) for key in ("frequency_hz", "damping_ratio", "decay_s")})


def _print_modes(out: Console, found: dict[str, Any]) -> None:
    places = ", ".join(point_text(point_of_json(at_m), 4) for at_m in found["finger_m"])
    grid = Grid("mode", "untouched", "damping", "decay", f"finger at {places}", "damping", "decay")
    empty = ("", "", "")
    for k in range(max(len(found["untouched"]), len(found["with_finger"]))):
        cells = [_cells(found[name][k]) if k < len(found[name]) else empty for name in ("untouched", "with_finger")]
        grid.add_row(f"{k + 1}", *cells[0], *cells[1])
    out.print(grid)
    say("Computed, not measured. Decay is the time to 1/e; modes of both sets are numbered by frequency.")
    say(found["estimates"])


def _cells(mode: dict[str, Any]) -> tuple[str, str, str]:
    decay = "no damping" if mode["decay_s"] is None else f"{1e3 * mode['decay_s']:.3g} ms"
    return f"{mode['frequency_hz']:.2f} Hz", f"{100 * mode['damping_ratio']:.3g} %", decay


def check(
    device_name: options.DeviceArgument, threshold: options.ThresholdCurve = None, as_json: options.AsJson = False
) -> None:
    """Validate a device file, and say what follows from it.

    It says what is estimated, the first modes, the bands of the actuators, and the greatest level in each zone.
    """
    from precompute.model.assembly import assemble
    from precompute.model.modal import compute_modes
    from precompute.studies.beam_limits import estimate_shear_error, estimate_torsion_hz, shortest_wave_m
    from precompute.studies.reach_along import compute_reach
    from tactable.explain.words import estimates_text

    path = find_device_file(device_name)
    device = options.with_threshold(find_device(device_name), threshold)
    middle_m = np.array([zone.middle_m for zone in device.zones])
    reach = compute_reach(assemble(device), middle_m, device.finger)
    first = compute_modes(device, middle_m, 2 * device.sweep.stop_hz)[:_CHECKED_MODES]
    levels = dict(zip((zone.name for zone in device.zones), reach.level_db.tolist(), strict=True))
    found = {
        "file": str(path),
        "device": device.name,
        "fingerprint": device.fingerprint,
        "estimated": list(device.estimated_values),
        "estimates": estimates_text(device),
        "marked": list(device.inferred),
        "modes": [_mode_json(mode) for mode in first],
        "bands_hz": {actuator.name: list(actuator.band_hz) for actuator in device.actuators},
        "inertial": {
            actuator.name: {
                "moving_mass_kg": actuator.moving_mass_kg,
                "resonance_hz": (actuator.stiffness_n_per_m / actuator.moving_mass_kg) ** 0.5 / (2 * np.pi),
            }
            for actuator in device.actuators
            if actuator.moving_mass_kg is not None
        },
        "clamped_m": {
            actuator.name: list(actuator.clamped_m(device.surface.length_m))
            for actuator in device.actuators
            if actuator.clamp_m
        },
        "electrodes": {
            actuator.name: to_plain(actuator.electrodes)
            | {"second_harmonic": actuator.electrodes.second_harmonic(device.limits.amplitude)}
            for actuator in device.actuators
            if actuator.electrodes is not None
        },
        "transfer_points": {
            actuator.name: len(actuator.transfer.frequency_hz)
            for actuator in device.actuators
            if actuator.transfer is not None
        },
        "sweep_hz": [device.sweep.start_hz, device.sweep.stop_hz, device.sweep.step_hz],
        "greatest_level_db": levels,
        "threshold": to_plain({key: getattr(device.threshold, key) for key in _THRESHOLD_KEYS}),
        "finger": _finger_json(device),
        "spread": device.spread_text,
        "surface": device.surface.kind,
        "waves_in_thickness": shortest_wave_m(device) / device.surface.thickness_m,
        "shear_error": estimate_shear_error(device),
        "torsion_hz": estimate_torsion_hz(device),
        "levels_out_of_reach": [
            {"level_db": level_db, "zones": [name for name, most_db in levels.items() if most_db < level_db]}
            for level_db in device.levels_db
            if min(levels.values()) < level_db
        ],
    }
    show(found, as_json, lambda *_: _say_check(found))


def _say_check(found: dict[str, Any]) -> None:
    say(f"{found['file']}: valid; {found['device']}, fingerprint {found['fingerprint'][:16]}")
    say(found["estimates"])
    listed = ", ".join(f"{m['frequency_hz']:.1f} Hz ({100 * m['damping_ratio']:.2g} %)" for m in found["modes"])
    say(f"first modes, untouched, with damping ratios: {listed}")
    for name, (low_hz, high_hz) in found["bands_hz"].items():
        say(f"band of {name}: {low_hz:g} to {high_hz:g} Hz")
    for name, mass in found["inertial"].items():
        own = f"{1e3 * mass['moving_mass_kg']:.3g} g on a spring, which on a surface at rest resonates"
        say(f"{name} is inertial: {own} at {mass['resonance_hz']:.4g} Hz")
    for name, (start_m, stop_m) in found["clamped_m"].items():
        say(f"bolts of {name} clamp the bar from {1e3 * start_m:.4g} to {1e3 * stop_m:.4g} mm: it does not bend there")
    for name, points in found["transfer_points"].items():
        say(f"transfer function of {name}: {points} points")
    for name, electrodes in found["electrodes"].items():
        say(_electrodes_text(name, electrodes))
    start_hz, stop_hz, step_hz = found["sweep_hz"]
    narrow = [m for m in found["modes"] if start_hz <= m["frequency_hz"] <= stop_hz and _width_hz(m) < step_hz]
    say(f"sweep: {start_hz:g} to {stop_hz:g} Hz in steps of {step_hz:g} Hz")
    for mode in narrow:
        say(f"note: the mode at {mode['frequency_hz']:.1f} Hz is {_width_hz(mode):.2g} Hz wide, narrower than a step")
    share, torsion_hz = found["shear_error"], found["torsion_hz"]
    theory = {"bar": "Euler and Bernoulli's theory of slender bars", "plate": "Kirchhoff's theory of thin plates"}
    text = (
        f"at {stop_hz:g} Hz the shortest wave is {found['waves_in_thickness']:.3g} times the thickness of the "
        f"{found['surface']}; {theory[found['surface']]} leaves out shear and rotary inertia, which lower modes by "
        f"{100 * share:.2g} % there and by 1 % at {0.01 / share * stop_hz / 1e3:.2g} kHz"
    )
    torsion = "" if torsion_hz is None else f"; first torsional mode near {torsion_hz:.3g} Hz"
    say(f"{'note: ' if share >= 0.01 else ''}{text}{torsion} (ESTIMATES)")
    if torsion_hz is not None and torsion_hz <= stop_hz:
        say("note: the first torsional mode lies within the band: the bar is a plate, and drives twist it")
    levels = ", ".join(f"{name} {level_db:.1f} dB" for name, level_db in found["greatest_level_db"].items())
    above = f"above threshold {found['threshold']['name']}"
    say(f"greatest level under a finger in the middle of each zone, dB {above}: {levels}")
    for short in found["levels_out_of_reach"]:
        say(f"note: {short['level_db']:g} dB is out of reach in {', '.join(short['zones'])}")
    say(_threshold_words(found["threshold"]))
    say(_finger_words(found["finger"]))
    say(f"clicks and drives are made for the spread {found['spread']}")
    say("Computed, not measured.")


def _electrodes_text(name: str, electrodes: dict[str, Any]) -> str:
    number = (
        "one electrode" if electrodes["number"] == 1 else f"two electrodes {electrodes['phase_gap_deg']:g} deg apart"
    )
    at_rest = f"electrodes of {name}: {number}, at rest at {100 * electrodes['bias']:g} % of the greatest voltage"
    ratio = electrodes["second_harmonic"]
    if ratio < _LEAST_RATIO:
        by = "" if electrodes["linearised_by"] == "nothing" else f", made so by the {electrodes['linearised_by']}"
        return f"{at_rest}; the force is linear{by}"
    return f"{at_rest}; second harmonic of the force {20 * np.log10(ratio):.1f} dB at full drive, which no level counts"


def _threshold_words(curve: dict[str, Any]) -> str:
    """The threshold curve with its range, and which of its points were measured."""
    low_hz, high_hz, measured_hz = curve["frequency_hz"][0], curve["frequency_hz"][-1], curve["measured_hz"]
    measured = "the source does not say which were measured"
    if measured_hz is not None:
        measured = f"measured at {', '.join(f'{hz:g}' for hz in measured_hz)} Hz, interpolated at the others"
    points = f"{len(curve['frequency_hz'])} points from {low_hz:g} to {high_hz:g} Hz; {measured}"
    return f"threshold {curve['name']}: {curve['title']}; {points}"


def _finger_json(device: "Device") -> Any:
    origin, finger = device.finger_origin, device.finger
    points = origin.impedance
    return to_plain(
        {
            "name": origin.name,
            "source": origin.source,
            "mass_kg": finger.mass_kg,
            "damping_n_s_per_m": finger.damping_n_s_per_m,
            "stiffness_n_per_m": finger.stiffness_n_per_m,
            "spread": finger.spread,
            "measured_points": len(points),
            "measured_hz": [points[0][0], points[-1][0]] if points else None,
            "misfit": origin.misfit,
            "is_within_clicks": (origin.misfit or 0.0) <= (device.spread.finger or finger.spread - 1),
        }
    )


def _finger_words(finger: dict[str, Any]) -> str:
    """The finger's values, and where they come from."""
    from engine.device.quantity import quantity_text

    parts = (("mass_kg", "kg"), ("damping_n_s_per_m", "N*s/m"), ("stiffness_n_per_m", "N/m"))
    values = ", ".join(quantity_text(finger[key], unit) for key, unit in parts)
    head = f"finger{' ' * bool(finger['name'])}{finger['name']}: {values}, {finger['spread']:g}-fold spread"
    source = f"; {finger['source']}" if finger["source"] else ""
    if finger["misfit"] is None:
        return head + source
    low_hz, high_hz = finger["measured_hz"]
    fitted = f"fitted to {finger['measured_points']} measured points from {low_hz:g} to {high_hz:g} Hz"
    beyond = "" if finger["is_within_clicks"] else "; clicks are made for less (spread.finger)"
    return f"{head}, {fitted}, off by {100 * finger['misfit']:.0f} % at most{beyond}{source}"


def _width_hz(mode: dict[str, Any]) -> float:
    """Half-power width."""
    return 2 * float(mode["damping_ratio"]) * float(mode["frequency_hz"])
