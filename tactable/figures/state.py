"""One entry along the bar: the acceleration that its drive gives, under the standard and the sampled fingers."""

import textwrap
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from engine.device import Device
from engine.table import Entry, Table
from engine.table.entry import ZonePrediction
from precompute.entries.prediction import touched_zones
from precompute.model.assembly import assemble
from precompute.model.response import solve_response
from precompute.model.threshold import detection_threshold
from precompute.sampling.fingers import SAMPLES, sample_fingers
from tactable.figures.file import Picture
from tactable.figures.style import (
    BLACK,
    BLUE,
    STATE_COLOUR,
    Array,
    draw_actuators,
    draw_zones,
    finish_picture,
    level_text,
    state_text,
    zone_lists,
)

_POINTS = 401
_BELOW_THRESHOLD = 0.3
"""The acceleration axis begins at this fraction of the threshold, or under the stillest finger."""
_HEADROOM = 4.0
"""And leaves room for the names of the zones above the greatest value."""
_TITLE_LETTERS = 100


@dataclass(frozen=True)
class Envelope:
    """Peak steady acceleration (m/s^2) along the bar (m): under standard fingers; least and greatest over touches."""

    position_m: Array
    standard: Array
    least: Array
    greatest: Array


def plot_state(table: Table, entry: Entry) -> Picture:
    """Picture of one entry of the table."""
    device = table.device
    envelope = compute_envelope(device, entry)
    tones_hz = _tones(entry)
    threshold = detection_threshold(tones_hz)
    figure = Figure(figsize=(9, 5.4), layout="constrained")
    axes = figure.add_subplot()
    _draw_envelope(axes, device, entry, envelope)
    _draw_thresholds(axes, tones_hz, threshold)
    _draw_fingers(axes, device, entry)
    _set_axes(axes, device, entry, envelope, threshold)
    axes.legend(fontsize="x-small", loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=2)
    return finish_picture(
        figure,
        device,
        f"{device.name}: {state_text(device, entry.states)}, {level_text(entry.wanted_level_db)}",
        _promise_text(entry),
        _columns(envelope),
        _summary(table, entry, tones_hz, threshold),
        subtitle=f"{_drive_text(device, entry)}\n{_promise_text(entry)}",
    )


def compute_envelope(device: Device, entry: Entry) -> Envelope:
    """Tones of different frequencies add as magnitudes, paper eq. (8)."""
    plant, sampled, touched = assemble(device), sample_fingers(device), touched_zones(entry.states)
    position_m = np.union1d(np.linspace(0.0, device.bar.length_m, _POINTS), sampled.middle_m)
    frequency_hz, tones_hz = np.array(entry.frequencies_hz), _tones(entry)
    amplitude = np.array(entry.amplitudes) * np.exp(1j * np.array(entry.phases_rad))
    weight = np.where(frequency_hz == tones_hz[:, None], amplitude, 0)

    def along(touch: int) -> Array:
        places_m, fingers = zip(*sampled.fingers(touch, touched), strict=True)
        response = solve_response(plant.with_fingers(places_m, fingers), tones_hz).acceleration(position_m)
        total: Array = abs(np.einsum("ta,tap->tp", weight, response)).sum(axis=0)
        return total

    each = np.array([along(touch) for touch in range(len(sampled.place))])
    return Envelope(position_m, each[0], each.min(axis=0), each.max(axis=0))


def _tones(entry: Entry) -> Array:
    """Shape (tone,): distinct frequencies of the actuators that move."""
    return np.unique(np.array(entry.frequencies_hz)[np.array(entry.amplitudes) > 0])


def _draw_envelope(axes: Axes, device: Device, entry: Entry, envelope: Envelope) -> None:
    draw_zones(axes, device, entry.states)
    place_mm = 1e3 * envelope.position_m
    label = f"least to greatest of {SAMPLES} other touches"
    axes.fill_between(place_mm, envelope.least, envelope.greatest, color=BLUE, alpha=0.15, lw=0, label=label)
    axes.plot(place_mm, envelope.standard, color=BLUE, lw=1.8, label="with standard fingers")
    draw_actuators(axes, device)


def _draw_thresholds(axes: Axes, tones_hz: Array, threshold: Array) -> None:
    for k, (hz, value) in enumerate(zip(tones_hz, threshold, strict=True)):
        style = ("--", "-.", ":")[k % 3]
        axes.axhline(value, color=BLACK, lw=1.0, ls=style, label=f"detection threshold at {hz:g} Hz (ESTIMATE)")
    if len(tones_hz) > 1:
        axes.plot([], [], " ", label="of several tones the levels add as powers")


def _draw_fingers(axes: Axes, device: Device, entry: Entry) -> None:
    axes.plot([], [], "o", ms=7, color=BLACK, label="standard finger, its level (least to greatest of the touches)")
    for zone, promise in zip(device.zones, entry.zones, strict=True):
        if promise.acceleration_at_finger_m_per_s2 is None or promise.sensation_level_range_db is None:
            continue
        middle_mm, height = 500 * (zone.start_m + zone.stop_m), promise.acceleration_at_finger_m_per_s2
        axes.plot(middle_mm, height, "o", ms=9, mec="white", color=STATE_COLOUR[promise.state], zorder=4)
        least_db, greatest_db = promise.sensation_level_range_db
        axes.annotate(
            f"{promise.sensation_level_db:z.1f} dB\n({least_db:z.0f} to {greatest_db:z.0f})",
            (middle_mm, height),
            xytext=(0, 9),
            textcoords="offset points",
            ha="center",
            fontsize="small",
            bbox={"boxstyle": "round,pad=0.15", "fc": "white", "ec": "none", "alpha": 0.8},
            zorder=5,
        )


def _set_axes(axes: Axes, device: Device, entry: Entry, envelope: Envelope, threshold: Array) -> None:
    under = [zone.acceleration_at_finger_m_per_s2 for zone in entry.zones]
    lowest = min([*_BELOW_THRESHOLD * threshold, *(value / 2 for value in under if value)])
    axes.set(
        xlabel="along the bar (mm)",
        ylabel="peak acceleration (m/s²)",
        xlim=(0, 1e3 * device.bar.length_m),
        yscale="log",
        ylim=(lowest, _HEADROOM * envelope.greatest.max()),
    )
    if len(threshold) == 1:
        reference = float(threshold[0])
        levels = axes.secondary_yaxis(
            "right",
            functions=(
                lambda value: 20 * np.log10(np.maximum(np.asarray(value, dtype=float), 1e-9) / reference),
                lambda level_db: reference * 10 ** (np.asarray(level_db, dtype=float) / 20),
            ),
        )
        levels.set_yscale("linear")
        levels.set_ylabel("sensation level (dB above threshold)")


def _drive_text(device: Device, entry: Entry) -> str:
    """What each actuator plays; a common frequency is said once."""
    tones_hz = _tones(entry)
    is_common = len(tones_hz) == 1
    parts = [
        f"{actuator.name} {100 * amplitude:.3g} %{'' if is_common else f' at {hz:g} Hz'}, {phase:+z.2f} rad"
        if amplitude
        else f"{actuator.name} still"
        for actuator, hz, amplitude, phase in zip(
            device.actuators, entry.frequencies_hz, entry.amplitudes, entry.phases_rad, strict=True
        )
    ]
    common = f" at {tones_hz[0]:g} Hz" if is_common else ""
    return textwrap.fill(f"{entry.family}{common}: {'; '.join(parts)}", _TITLE_LETTERS)


def _promise_text(entry: Entry) -> str:
    reached = "" if entry.achieved else f"NOT ACHIEVED, {entry.level_db:.1f} dB at most; "
    if entry.contrast_db is None or entry.expected_contrast_db is None or entry.worst_case.contrast_db is None:
        return f"{reached}localized factor {entry.localized_factor:.3f} (worst {entry.worst_case.localized_factor:.3f})"
    contrasts = f"expected {entry.expected_contrast_db:z.1f}, worst {entry.worst_case.contrast_db:z.1f}"
    return f"{reached}contrast {entry.contrast_db:z.1f} dB ({contrasts})"


def _columns(envelope: Envelope) -> dict[str, Array]:
    return {
        "position (m)": envelope.position_m,
        "peak acceleration under standard fingers (m/s^2)": envelope.standard,
        "least over sampled touches (m/s^2)": envelope.least,
        "greatest over sampled touches (m/s^2)": envelope.greatest,
    }


def _summary(table: Table, entry: Entry, tones_hz: Array, threshold: Array) -> dict[str, object]:
    return {
        **zone_lists(table.device, entry.states),
        "wanted_level_db": entry.wanted_level_db,
        "level_db": entry.level_db,
        "achieved": entry.achieved,
        "contrast_db": entry.contrast_db,
        "expected_contrast_db": entry.expected_contrast_db,
        "worst_contrast_db": entry.worst_case.contrast_db,
        "localized_factor": entry.localized_factor,
        "threshold_m_per_s2": dict(zip(map(str, tones_hz.tolist()), threshold.tolist(), strict=True)),
        "fingers": [_finger_summary(zone) for zone in entry.zones if zone.sensation_level_db is not None],
    }


def _finger_summary(zone: ZonePrediction) -> dict[str, object]:
    return {
        "zone": zone.name,
        "state": zone.state.name.lower(),
        "acceleration_at_finger_m_per_s2": zone.acceleration_at_finger_m_per_s2,
        "sensation_level_db": zone.sensation_level_db,
        "sensation_level_range_db": zone.sensation_level_range_db,
    }
