"""What a session shows, as a page in Markdown, a picture, and the participant's own threshold curve."""

import json
from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from engine.device.threshold import Threshold
from tactable.experiment.analysis import NEAR_CHANCE, Estimate, Row, ShareFit, TrackFit
from tactable.experiment.protocol import Kind, Protocol
from tactable.experiment.quest_plus import probability_correct
from tactable.experiment.session import stimulus_axis
from tactable.figures.picture_file import Picture
from tactable.figures.style import BLACK, BLUE, GREEN, GREY, VERMILLION

PROMISED = 0.9  # felt reaches and quiet keeps to its level, each in 95 % of the plants: both in at least 90 %
_REFERENCE_M_PER_S2 = 1e-6
_SAME_HZ = 0.02  # tones that are closer, relative, are one point of a curve


def report_text(
    protocol: Protocol, rows: Sequence[Row], fits: tuple[Sequence[TrackFit], Sequence[ShareFit]], title: str, note: str
) -> str:
    """The report as Markdown. title: whose it is; note: device, curve, and whether it is SIMULATED."""
    tracks, shares = fits
    lines = [f"# {title}: {protocol.title}", "", f"{len(rows)} trials. {note}", ""]
    if tracks:
        lines += [
            "The threshold is what is detected in half of the trials: with two answers 75 % are right there. "
            f"Near chance, {100 * NEAR_CHANCE:.0f} % are detected. Intervals are of 95 %.",
            "",
            "| task | finger | trials | threshold | near chance | slope | no attention | bias | drift in 100 trials |",
            "|---|---|---|---|---|---|---|---|---|",
            *(_track_row(fit) for fit in tracks),
            "",
        ]
        lines += [f"- {sentence}" for fit in tracks if (sentence := _sentence(fit))]
    for fit in shares:
        lines += [f"- **{fit.task.name}**: {share_sentence(fit)}"]
        lines += [f"  {how[0].upper()}{how[1:]}: {count}." for how, count in fit.confused.items()]
    curve = personal_curve_points(tracks)
    if curve:
        lines += [
            "",
            "The tones make a threshold curve of this participant (`_threshold.toml` beside this page), which a table "
            "is built for by `tactable build DEVICE --threshold FILE`.",
        ]
    return "\n".join(lines) + "\n"


def _track_row(fit: TrackFit) -> str:
    threshold = interval_words(fit.threshold) if fit.is_shown else "beyond what was asked"
    finger = "both" if fit.task.kind is Kind.WHICH_FINGER else fit.task.finger_name(fit.finger).removeprefix("your ")
    cells = (
        f"{fit.task.name}{'' if fit.frequency_hz is None else f' ({fit.frequency_hz:.0f} Hz)'}",
        finger,
        f"{fit.trials}",
        threshold,
        interval_words(fit.near_chance) if fit.is_shown else "",
        f"{fit.slope:.1f}",
        f"{100 * fit.lapse:.0f} %",
        f"{100 * fit.bias:+.0f} % to the first",
        f"{fit.drift_db:+.1f} dB",
    )
    return f"| {' | '.join(cells)} |"


def interval_words(found: Estimate) -> str:
    """A level with its interval."""
    return f"{found.middle:.1f} dB ({found.low:.1f} to {found.high:.1f})"


def _sentence(fit: TrackFit) -> str:
    if not fit.is_shown:
        return (
            f"**{fit.task.name}**: the threshold may lie beyond the levels of the task; widen `levels` or add trials."
        )
    if fit.task.kind is Kind.WHICH_FINGER and fit.quiet_db is not None:
        quiet = fit.threshold.middle - fit.quiet_db
        return (
            f"**{fit.task.name}**: at the threshold the other finger is predicted to feel {quiet:.1f} dB "
            f"({fit.quiet_db:.1f} dB less)."
        )
    return ""


def share_sentence(fit: ShareFit) -> str:
    """How often felt and not felt were kept, and what that says of the promise."""
    low, _, high = (100 * each for each in fit.share)
    found = (
        f"kept in {fit.kept} of {fit.trials} touches ({100 * fit.kept / fit.trials:.0f} %, {low:.0f} to {high:.0f} %)"
    )
    verdict = (
        "at least as promised"
        if fit.share.low > PROMISED
        else "less than the promise: this person, or this device, is not what the table was made for"
        if fit.share.high < PROMISED
        else "the promise lies within the interval"
    )
    levels = ""
    if fit.felt_low_db is not None and fit.quiet_high_db is not None:
        levels = f", felt at least {fit.felt_low_db:.1f} dB and quiet at most {fit.quiet_high_db:.1f} dB"
    return (
        f"{found}; the table promises it in {100 * PROMISED:.0f} % of the devices and fingers{levels}: {verdict}. "
        f"In {fit.false_alarms} of {fit.catch} catch trials something was felt."
    )


def personal_curve_points(tracks: Sequence[TrackFit]) -> list[tuple[float, float]]:
    """Frequency (Hz) and what the participant's threshold is above the device's (dB), of the tones that show it."""
    points: list[tuple[float, list[float]]] = []
    found = [fit for fit in tracks if fit.task.kind is Kind.DETECTION and fit.is_shown and fit.frequency_hz]
    for fit in sorted(found, key=lambda fit: fit.frequency_hz or 0.0):
        hz = fit.frequency_hz or 0.0
        if points and hz < points[-1][0] * (1 + _SAME_HZ):
            points[-1][1].append(fit.threshold.middle)
        else:
            points.append((hz, [fit.threshold.middle]))
    return [(round(hz, 1), float(np.mean(levels_db))) for hz, levels_db in points]


def personal_curve(tracks: Sequence[TrackFit], base: Threshold, name: str, note: str) -> str | None:
    """A file in the form of tables/thresholds; None without a tone that shows a threshold.

    It is the device's curve, moved by what was measured: between the tones by straight lines over the logarithm of
    frequency, beyond them by as much as at the last.
    """
    points = personal_curve_points(tracks)
    if not points:
        return None
    measured_hz, moved_db = np.array(points).T
    hz = np.array(sorted({*base.frequency_hz, *measured_hz.tolist()}))
    level_db = 20 * np.log10(base.peak_m_per_s2(hz) / _REFERENCE_M_PER_S2)
    level_db = level_db + np.interp(np.log(hz), np.log(measured_hz), moved_db)
    source = f"{note} All other points are those of {base.name}, moved as much as the nearest tones: ESTIMATES."
    return "\n".join(
        [
            "# The detection threshold of one participant, made by `tactable experiment`.",
            f"name = {json.dumps(name)}",
            f"title = {json.dumps(f'detection threshold of {name}, measured')}",
            f"source = {json.dumps(source, ensure_ascii=False)}",
            'quantity = "acceleration"',
            'amplitude = "peak"',
            'reference = "1e-6 m/s^2"',
            f'interpolation = "{base.interpolation}"',
            f'beyond = "{base.beyond}"',
            f"frequency_hz = {hz.tolist()}",
            f"level_db = {np.round(level_db, 2).tolist()}",
            f"measured_hz = {measured_hz.tolist()}\n",
        ]
    )


def report_picture(tracks: Sequence[TrackFit], shares: Sequence[ShareFit], title: str) -> Picture:
    """A panel for each track with its answers and its function, and one for the shares."""
    count = len(tracks) + bool(shares)
    across = min(count, 3)
    down = -(-count // across)
    figure = Figure(figsize=(3.6 * across + 0.6, 3.2 * down + 0.5), layout="constrained")
    panels = figure.subplots(down, across, squeeze=False).ravel()
    for fit, axes in zip(tracks, panels, strict=False):
        level_db, number, share = fit.stimuli.T
        x = np.linspace(level_db.min(), level_db.max(), 200)
        at = [stimulus_axis(fit.task, each) for each in (*x, fit.threshold.middle)]
        axes.plot(x, probability_correct(np.array(at[:-1]), at[-1], fit.slope, fit.lapse, 0.5), color=BLUE)
        axes.scatter(level_db, share, 8 * number, color=BLACK, alpha=0.6, zorder=3)
        axes.axhline(0.5, color=GREY, lw=0.8, ls=":")
        if fit.is_shown:
            axes.hlines(0.75, fit.threshold.low, fit.threshold.high, color=VERMILLION, lw=2)
            axes.plot(fit.threshold.middle, 0.75, "o", color=VERMILLION)
        what = "difference (dB)" if fit.task.kind is Kind.DISCRIMINATION else "level (dB above threshold)"
        finger = (
            ""
            if len(fit.task.position_m) == 1 or fit.task.kind is Kind.WHICH_FINGER
            else f", {('left', 'right')[fit.finger]}"
        )
        hertz = "" if fit.frequency_hz is None else f", {fit.frequency_hz:.0f} Hz"
        axes.set(xlabel=what, ylabel="right answers", ylim=(-0.03, 1.05))
        axes.set_title(f"{fit.task.name}{finger}{hertz}", fontsize="small")
    for axes in panels[count:]:
        axes.set_visible(False)
    if shares:
        axes = panels[len(tracks)]
        for place, each in enumerate(shares):
            middle = each.kept / each.trials
            off = [[middle - each.share.low], [each.share.high - middle]]
            axes.errorbar(place, middle, off, fmt="o", color=GREEN, capsize=6)
        axes.axhline(PROMISED, color=GREY, ls="--", lw=0.8)
        axes.text(-0.45, PROMISED, "promised", va="bottom", fontsize="x-small", color="dimgrey")
        axes.set_xticks(range(len(shares)), [each.task.name for each in shares])
        axes.set(ylabel="felt and not felt kept", ylim=(-0.03, 1.05), xlim=(-0.5, len(shares) - 0.5))
        axes.set_title("felt and not felt", fontsize="small")
    figure.suptitle(title, fontsize="medium")
    return Picture(figure, {}, {}, title)  # its data are the rows of the CSV file
