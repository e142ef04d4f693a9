"""One click: its waveform, what every finger feels of it, and how that varies between sampled plants."""

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from base.arrays import Array
from base.points import point_text
from engine.device import Device
from engine.table import ClickEntry
from engine.touch import Placement
from precompute.clicks.click_basis import EVALUATION_RATE_HZ, interpolated
from precompute.clicks.evaluation import decibels
from tactable.explain.click_source import ClickSource
from tactable.explain.words import finger_roles, placement_json, placement_text, zone_lists
from tactable.figures import style
from tactable.figures.picture_file import Picture


@dataclass(frozen=True, eq=False)
class Course:
    """A click over time, as it is played, under fingers at the positions of `placement`.

    time_s has the shape (time,); displacement (actuator, time) is in fractions of full scale; weighted (plant, finger,
    time) is acceleration over the detection threshold. The nominal plant is first; the sampled plants follow, with
    which no click was made.
    """

    click: ClickEntry
    placement: Placement
    time_s: Array
    displacement: Array
    weighted: Array

    @property
    def felt_first(self) -> list[int]:
        """Indices of the felt, then of the quiet fingers."""
        return [*self.placement.felt, *self.placement.quiet]

    def peaks_db(self, finger: int) -> tuple[float, float, float, float]:
        """Peak under one finger, dB above threshold: nominal, then 5th, 50th and 95th percentile over plants."""
        peak_db = decibels(abs(self.weighted[:, finger]).max(axis=1))
        low, middle, high = np.percentile(peak_db[1:], (5, 50, 95)).tolist()
        return float(peak_db[0]), low, middle, high

    def fan(self, finger: int) -> Array:
        """5th, 50th and 95th percentile over the sampled plants at each instant, shape (3, time)."""
        return np.percentile(self.weighted[1:, finger], (5, 50, 95), axis=0)


def compute_course(source: ClickSource, click: ClickEntry, placement: Placement) -> Course:
    """Compute the time course of a click of the source's device under the fingers of a placement."""
    wave = click.waveform.T
    responses = source.solver.plants_of(placement.position_m).judged
    drawn = interpolated(wave)
    displacement = np.zeros((len(drawn), responses.steps))
    displacement[:, : drawn.shape[1]] = drawn
    return Course(
        click=click,
        placement=placement,
        time_s=np.arange(responses.steps) / EVALUATION_RATE_HZ,
        displacement=displacement,
        weighted=responses.play(wave).astype(np.float64),
    )


SPREAD_NOTE = "spreads of the sampled plants"
_SHOWN_AFTER_S = 0.03  # how much of the ringing is drawn; the data have all that is looked at
_LEGEND_ROOM = 1.6  # of the greatest value, above the curves
_BANDS = ((0.0, 0.4, "under the threshold (ESTIMATE)"), (8.0, 0.15, "up to 8 dB above it"))
"""Around zero: what few people feel, and what some do not."""
_STYLES = ("-", "--", "-.", ":")
_PLAYERS = (style.BLUE, style.BLACK, style.GREY)
_HEIGHT_INCHES = {"wave": 1.8, "felt": 2.4, "fan": 2.1}
_EDGES_INCHES = 1.5  # title, notes and the axis of time


def plot_click(source: ClickSource, click: ClickEntry, placement: Placement) -> Picture:
    """Picture of a click of the source's device, as it is played, under the fingers of a placement."""
    device, course = source.table.device, compute_course(source, click, placement)
    fingers = len(placement.position_m)
    rows = (fingers + 1) // 2
    heights = [_HEIGHT_INCHES["wave"], _HEIGHT_INCHES["felt"], *[_HEIGHT_INCHES["fan"]] * rows]
    figure = Figure(figsize=(9, sum(heights) + _EDGES_INCHES), layout="constrained")
    grid = figure.add_gridspec(2 + rows, 2, height_ratios=heights)
    _draw_waveform(figure.add_subplot(grid[0, :]), device, course)
    _draw_nominal(figure.add_subplot(grid[1, :]), device, course)
    for k, finger in enumerate(course.felt_first):
        is_alone = k % 2 == 0 and k == fingers - 1
        _draw_fan(figure.add_subplot(grid[2 + k // 2, slice(None) if is_alone else k % 2]), device, course, finger)
    return style.finish_picture(
        figure,
        device,
        f"{device.name}: {placement_text(device, placement)}, a click of {1e3 * click.length_s:g} ms",
        promise_text(click),
        _columns(device, course),
        _summary(source, course),
        notes=(style.FINGER_NOTE, SPREAD_NOTE, style.THRESHOLD_NOTE),
        subtitle=f"made for {_made_for(click)}: {promise_text(click)}",
    )


def promise_text(click: ClickEntry) -> str:
    """Promise of a click in one line."""
    wanted = f" ({style.level_text(click.wanted_level_db)} wanted)" if np.isfinite(click.wanted_level_db) else ""
    parts = [] if click.achieved else [f"NOT ACHIEVED{wanted}"]
    parts.append(f"felt {click.felt.low_db:z.1f} dB above threshold (5 % of fresh plants are below)")
    if click.quiet is not None:
        parts.append(f"quiet {click.quiet.high_db:z.1f} dB (5 % are above)")
    return ", ".join(parts)


def _made_for(click: ClickEntry) -> str:
    """The places of a click, such as "35.7 mm and 118.9 mm, each finger within 2.5 mm"."""
    places = " and ".join(point_text(at_m, 4) for at_m in click.placement.position_m)
    return f"{places}, {'each' if len(click.fingers) > 1 else 'the'} finger within {1e3 * click.tolerance_m:.3g} mm"


def _draw_waveform(axes: Axes, device: Device, course: Course) -> None:
    for i, (actuator, moved) in enumerate(zip(device.actuators, course.displacement, strict=True)):
        colour, ls = _PLAYERS[i % len(_PLAYERS)], _STYLES[i % len(_STYLES)]
        axes.plot(1e3 * course.time_s, 100 * moved, color=colour, ls=ls, lw=1.4, label=actuator.name)
    limit = 100 * device.limits.amplitude
    axes.set(ylabel="base (% of full scale)", ylim=(-1.1 * limit, 1.1 * limit))
    _finish(axes, course, "what the actuators do")
    axes.legend(fontsize="x-small", loc="upper right", ncols=len(device.actuators))


def _draw_nominal(axes: Axes, device: Device, course: Course) -> None:
    _draw_threshold(axes)
    click, drawn = course.click, {True: 0, False: 0}
    for finger in course.felt_first:
        is_felt = course.placement.is_felt[finger]
        name, ls = finger_roles(device, course.placement)[finger], _STYLES[drawn[is_felt] % len(_STYLES)]
        drawn[is_felt] += 1
        nominal = course.weighted[0, finger]
        axes.plot(1e3 * course.time_s, nominal, color=style.ROLE_COLOUR[is_felt], ls=ls, lw=1.4, label=name)
    axes.set(ylabel="acceleration\n(1 = threshold)")
    left = f"from {1e3 * click.residual_from_s:g} ms on at most {click.residual_db:z.1f} dB under a felt finger"
    _finish(axes, course, f"nominal plant: acceleration weighted by the detection threshold; {left}")
    axes.legend(fontsize="x-small", loc="upper right", ncols=3)


def _draw_fan(axes: Axes, device: Device, course: Course, finger: int) -> None:
    is_felt = course.placement.is_felt[finger]
    time_ms, colour = 1e3 * course.time_s, style.ROLE_COLOUR[is_felt]
    low, middle, high = course.fan(finger)
    _, *peaks_db = course.peaks_db(finger)
    _draw_threshold(axes, is_named=False)
    axes.fill_between(time_ms, low, high, color=colour, alpha=0.35, lw=0, label="5 to 95 % at each instant")
    axes.plot(time_ms, middle, color=colour, lw=1.2, label="50 %")
    promised = 10 ** (peaks_db[0 if is_felt else 2] / 20)
    label = f"5 % of the peaks are {'below' if is_felt else 'above'}"
    axes.hlines([-promised, promised], *time_ms[[0, -1]], color=style.BLACK, ls=":", lw=1.2, label=label)
    low_limit, high_limit = axes.get_ylim()
    axes.set(ylabel="1 = threshold", xlabel="time (ms)", ylim=(low_limit, _LEGEND_ROOM * high_limit))
    peaks = " / ".join(f"{peak_db:z.1f}" for peak_db in peaks_db)
    title = f"{finger_roles(device, course.placement)[finger]}: {course.weighted.shape[0] - 1} fresh plants"
    _finish(axes, course, f"{title},\npeaks {peaks} dB (5 / 50 / 95 %)")
    axes.legend(fontsize="x-small", loc="upper right", ncols=2)


def _draw_threshold(axes: Axes, *, is_named: bool = True) -> None:
    for reach_db, alpha, name in _BANDS:
        reach = 10 ** (reach_db / 20)
        axes.axhspan(-reach, reach, color=style.GREY, alpha=alpha, lw=0, label=name if is_named else None)


def _finish(axes: Axes, course: Course, title: str) -> None:
    axes.set_xlim(0, 1e3 * (course.click.length_s + _SHOWN_AFTER_S))
    axes.set_title(title, fontsize="small", loc="left")
    axes.grid(alpha=0.25)


def _columns(device: Device, course: Course) -> dict[str, Array]:
    columns = {"time (s)": course.time_s}
    for actuator, moved in zip(device.actuators, course.displacement, strict=True):
        columns[f"{actuator.name} (fraction of full scale)"] = moved
    for finger in course.felt_first:
        name = finger_roles(device, course.placement)[finger]
        columns[f"{name}, nominal (acceleration over threshold)"] = course.weighted[0, finger]
        for percent, curve in zip((5, 50, 95), course.fan(finger), strict=True):
            columns[f"{name}, {percent} % of plants (acceleration over threshold)"] = curve
    return columns


def _summary(source: ClickSource, course: Course) -> dict[str, object]:
    device, click = source.table.device, course.click
    return {
        **zone_lists(device, course.placement),
        "is_tabulated": source.holds(course.placement),
        "places_m": click.placement.position_m,
        "tolerance_m": click.tolerance_m,
        "length_s": click.length_s,
        "wanted_level_db": click.wanted_level_db,
        "level_db": click.level_db,
        "quiet_level_db": None if click.quiet is None else click.quiet.high_db,
        "achieved": click.achieved,
        "fingers": [_finger_summary(device, course, finger) for finger in course.felt_first],
        "plants": course.weighted.shape[0] - 1,
    }


def _finger_summary(device: Device, course: Course, finger: int) -> dict[str, object]:
    nominal_db, *others_db = course.peaks_db(finger)
    return {
        **placement_json(device, course.placement)[finger],
        "nominal_db": nominal_db,
        "peak_db": dict(zip(("5 %", "50 %", "95 %"), others_db, strict=True)),
    }
