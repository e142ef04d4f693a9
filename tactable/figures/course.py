"""One steady drive started from rest: the level under every finger while the bar rises, and the contrast."""

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from base.arrays import Array
from precompute.model.assembly import assemble
from precompute.model.modal import compute_basis
from precompute.predict.rise_time import compute_envelopes, compute_rise_model
from tactable.explain.words import finger_roles, placement_json, placement_text, rise_text, zone_lists
from tactable.figures.picture_file import Picture
from tactable.figures.state_picture import PlayedDrive
from tactable.figures.style import BLACK, BLUE, GREY, ROLE_COLOUR, finish_picture, level_text

PROMPT_MS = (5.0, 50.0)  # when tactile feedback should follow (Kaaresoja, Brewster & Lantz 2014, 10.1145/2611387)
_STEP_S = 5e-4  # seven samples in a period of 300 Hz; envelopes change slower
_LONGER, _SHORTEST_S = 2.5, 0.3  # the time axis ends after this many rise times, but not before the shortest time
_LOWEST_DB = 50.0  # how far the axis reaches below the greatest level
_STYLES = ("-", "--", "-.", ":")
_TINY = 1e-12  # -120 dB, below the axis: silence has a logarithm


@dataclass(frozen=True)
class Rising:
    """time_s (time,); level_db (finger, time), dB above threshold; contrast_db (time,), None without a quiet finger."""

    time_s: Array
    level_db: Array
    contrast_db: Array | None

    @property
    def early_contrast_db(self) -> float | None:
        """The contrast at the end of prompt feedback."""
        return None if self.contrast_db is None else float(np.interp(PROMPT_MS[1] / 1e3, self.time_s, self.contrast_db))


def plot_course(played: PlayedDrive) -> Picture:
    """Picture of a drive that is started at once, standard fingers on the bar."""
    device, rising = played.device, compute_rising(played)
    has_contrast = rising.contrast_db is not None
    figure = Figure(figsize=(9, 6.0 if has_contrast else 4.2), layout="constrained")
    heights = [3, 2] if has_contrast else [1]
    panels = figure.subplots(len(heights), 1, sharex=True, height_ratios=heights, squeeze=False)[:, 0]
    _draw_levels(panels[0], played, rising)
    if rising.contrast_db is not None:
        _draw_contrast(panels[1], played, rising.time_s, rising.contrast_db)
    panels[-1].set_xlabel("time from rest (ms)")
    who = placement_text(device, played.placement)
    words = f"risen after {rise_text(played.figures.t90_s)}"
    if rising.early_contrast_db is not None:
        steady = f"{played.figures.contrast_db:z.1f} dB steady"
        words += f"; contrast {rising.early_contrast_db:z.1f} dB after {PROMPT_MS[1]:g} ms, {steady}"
    return finish_picture(
        figure,
        device,
        f"{device.name}: {who}, {level_text(played.drive.wanted_level_db)}, from rest",
        words,
        _columns(played, rising),
        {
            **zone_lists(device, played.placement),
            "fingers": placement_json(device, played.placement),
            "wanted_level_db": played.drive.wanted_level_db,
            "t90_s": played.figures.t90_s,
            "contrast_db": played.figures.contrast_db,
            "contrast_after_50_ms_db": rising.early_contrast_db,
        },
        subtitle=words,
    )


def compute_rising(played: PlayedDrive) -> Rising:
    """Levels of tones of different frequencies add as powers."""
    position_m = np.array(played.placement.position_m)
    model = compute_rise_model(compute_basis(assemble(played.device)), played.figures.loads[0], position_m)
    time_s = np.arange(_STEP_S, max(_SHORTEST_S, _LONGER * played.figures.t90_s), _STEP_S)
    hz, amplitude = np.array(played.drive.frequencies_hz), played.drive.complex_amplitudes
    tones_hz, envelope = compute_envelopes(model, hz, amplitude, time_s)
    threshold_m_per_s2 = played.device.threshold.peak_m_per_s2(tones_hz)
    power = ((envelope / threshold_m_per_s2[:, None, None]) ** 2).sum(axis=0)
    level_db: Array = 10 * np.log10(np.maximum(power, _TINY))
    felt, quiet = played.placement.felt, played.placement.quiet
    contrast_db = level_db[felt].min(axis=0) - level_db[quiet].max(axis=0) if quiet else None
    return Rising(time_s, level_db, contrast_db)


def _draw_levels(axes: Axes, played: PlayedDrive, rising: Rising) -> None:
    _draw_prompt(axes)
    drawn = {True: 0, False: 1}
    for name, finger, level_db in zip(
        finger_roles(played.device, played.placement), played.fingers, rising.level_db, strict=True
    ):
        style, colour = _STYLES[drawn[finger.is_felt] % len(_STYLES)], ROLE_COLOUR[finger.is_felt]
        drawn[finger.is_felt] += 1
        axes.plot(1e3 * rising.time_s, level_db, color=colour, ls=style, lw=1.6, label=name)
        axes.plot(1e3 * rising.time_s[-1], finger.level_db, "<", ms=8, color=colour, clip_on=False)
    axes.plot([], [], "<", ms=8, color=BLACK, label="promised")
    axes.axvline(
        1e3 * played.figures.t90_s, color=BLACK, ls=":", lw=1.2, label=f"t90, {1e3 * played.figures.t90_s:.0f} ms"
    )
    axes.axhline(0.0, color=GREY, lw=1.2, ls="--", label="detection threshold (ESTIMATE)")
    top_db = float(rising.level_db.max())
    axes.set(ylabel="level (dB above threshold)", ylim=(top_db - _LOWEST_DB, top_db + 3.0))
    axes.set_xlim(0, 1e3 * rising.time_s[-1])
    axes.grid(alpha=0.25)
    axes.legend(fontsize="x-small", loc="lower right", ncols=2)


def _draw_contrast(axes: Axes, played: PlayedDrive, time_s: Array, contrast_db: Array) -> None:
    _draw_prompt(axes)
    axes.plot(1e3 * time_s, contrast_db, color=BLUE, lw=1.6)
    assert played.figures.contrast_db is not None
    axes.plot(1e3 * time_s[-1], played.figures.contrast_db, "<", ms=8, color=BLACK, clip_on=False)
    axes.axhline(0.0, color=GREY, lw=0.8)
    axes.axvline(1e3 * played.figures.t90_s, color=BLACK, ls=":", lw=1.2)
    axes.set(ylabel="contrast, felt over\nquiet, at that moment (dB)")
    axes.grid(alpha=0.25)


def _draw_prompt(axes: Axes) -> None:
    axes.axvspan(*PROMPT_MS, color=GREY, alpha=0.25, lw=0, label="5 to 50 ms: prompt feedback")


def _columns(played: PlayedDrive, rising: Rising) -> dict[str, Array]:
    columns = {"time (s)": rising.time_s}
    for name, level_db in zip(finger_roles(played.device, played.placement), rising.level_db, strict=True):
        columns[f"level of {name} (dB above threshold)"] = level_db
    if rising.contrast_db is not None:
        columns["contrast (dB)"] = rising.contrast_db
    return columns
