"""One steady drive over the surface: the acceleration that it gives under the standard and the sampled fingers."""

import textwrap
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from base.arrays import Array, Points
from engine.device import Device, Finger
from engine.steady import SteadyDrive
from engine.touch import Placement, ZoneState
from precompute.model.assembly import assemble
from precompute.model.gram import compute_steady_state
from precompute.model.response import peak_along
from precompute.predict.at_positions import PlacementFigures, SteadyDesigner
from tactable.explain.words import placement_json, placement_text, zone_lists
from tactable.figures import style
from tactable.figures.picture_file import Picture


@dataclass(frozen=True)
class PlayedFinger:
    """Level under a standard finger; range_db: least and greatest level of the sampled ones."""

    position_m: complex
    is_felt: bool
    acceleration_m_per_s2: float
    level_db: float
    range_db: tuple[float, float]


@dataclass(frozen=True)
class PlayedDrive:
    """A steady drive with the fingers that it is for.

    worst_contrast_db: over the sampled fingers, None where nothing is quiet.
    """

    device: Device
    placement: Placement
    figures: PlacementFigures
    threshold_m_per_s2: float
    worst_contrast_db: float | None
    localized_factor: float
    fingers: tuple[PlayedFinger, ...]

    @property
    def drive(self) -> SteadyDrive:
        """The drive, of one frequency."""
        return self.figures.drive


def solved_drive(designer: SteadyDesigner, placement: Placement, level_db: float) -> PlayedDrive:
    """The drive that a run solves for these positions, its sampled fingers within a millimetre of them."""
    device = designer.plant.device
    figures = designer.solve(placement.position_m, placement.is_felt, level_db)
    drive = figures.drive
    threshold_m_per_s2 = float(device.threshold.peak_m_per_s2(np.array([drive.frequency_hz]))[0])
    ends_db = np.stack([figures.sampled_level_db.min(axis=0), figures.sampled_level_db.max(axis=0)], axis=1)
    loaded = assemble(device).with_fingers(placement.position_m, device.finger)
    share = compute_steady_state(loaded, np.array(drive.frequencies_hz), drive.complex_amplitudes).share
    felt_zones = [zone for zone, state in enumerate(placement.zone_states(device)) if state is ZoneState.FELT]
    weakest = figures.sampled_level_db[:, placement.felt].min(axis=1)
    strongest = figures.sampled_level_db[:, placement.quiet].max(axis=1, initial=-np.inf)
    return PlayedDrive(
        device=device,
        placement=placement,
        figures=figures,
        threshold_m_per_s2=threshold_m_per_s2,
        worst_contrast_db=float((weakest - strongest).min()) if placement.quiet else None,
        localized_factor=float(share[felt_zones].sum()),
        fingers=tuple(
            PlayedFinger(at_m, is_felt, threshold_m_per_s2 * 10 ** (level / 20), level, (low, high))
            for at_m, is_felt, level, (low, high) in zip(
                placement.position_m, placement.is_felt, figures.level_db.tolist(), ends_db.tolist(), strict=True
            )
        ),
    )


_MAP_POINTS = 1500  # 6 mm apart on a tablet
_LOWEST_DB = -20.0  # where the map of a plate begins
_BELOW_THRESHOLD = 0.3  # the acceleration axis begins at this fraction of the threshold, or under the stillest finger
_HEADROOM = 4.0  # factor on the greatest value, which leaves room for the names of the zones above it
_TITLE_LETTERS = 100  # a line of the title across the figure


@dataclass(frozen=True)
class Envelope:
    """Peak steady acceleration (m/s^2) at points (m): under standard fingers; least and greatest over touches."""

    position_m: Points
    standard: Array
    least: Array
    greatest: Array


def plot_state(played: PlayedDrive) -> Picture:
    """Picture of a drive that is solved for fingers."""
    device, envelope = played.device, compute_envelope(played)
    height = 1.2 + style.map_height(device, 7.0) if style.is_plate(device) else 5.4
    figure = Figure(figsize=(9, height), layout="constrained")
    axes = figure.add_subplot()
    (_draw_map if style.is_plate(device) else _draw_along)(axes, played, envelope)
    return style.finish_picture(
        figure,
        device,
        f"{device.name}: {placement_text(device, played.placement)}, {style.level_text(played.drive.wanted_level_db)}",
        _promise_text(played),
        _columns(envelope),
        _summary(played),
        subtitle=f"{_drive_text(played)}\n{_promise_text(played)}",
    )


def compute_envelope(played: PlayedDrive) -> Envelope:
    """The drive under each load of fingers."""
    device, frequency_hz = played.device, np.array(played.drive.frequencies_hz)
    plant = assemble(device)
    position_m = style.surface_field(device, _MAP_POINTS).position_m
    if not style.is_plate(device):
        position_m = np.union1d(position_m, played.placement.position_m)

    def along(load: list[tuple[complex, Finger]]) -> Array:
        loaded = plant.with_fingers(*zip(*load, strict=True))
        return peak_along(loaded, frequency_hz, played.drive.complex_amplitudes, position_m)

    each = np.array([along(load) for load in played.figures.loads])
    return Envelope(position_m, each[0], each.min(axis=0), each.max(axis=0))


def _draw_map(axes: Axes, played: PlayedDrive, envelope: Envelope) -> None:
    """Levels under standard fingers, a plate seen from above; white where they cross the threshold."""
    device, field = played.device, style.surface_field(played.device, _MAP_POINTS)
    level_db = 20 * np.log10(np.maximum(envelope.standard / played.threshold_m_per_s2, 1e-9))
    style.draw_map(axes, device, field, level_db, f"level (dB {device.threshold.above})", vmin=_LOWEST_DB)
    rows = level_db.reshape(field.across, field.along)
    axes.contour(
        rows, [0.0], colors="white", linestyles="--", linewidths=1.2, extent=(*axes.get_xlim(), *axes.get_ylim())
    )
    style.draw_fingers(axes, played.placement, [_level_text(each) for each in played.fingers])
    axes.set_title("dashed: the detection threshold; in brackets least to greatest of the touches", fontsize="small")


def _draw_along(axes: Axes, played: PlayedDrive, envelope: Envelope) -> None:
    _draw_envelope(axes, played, envelope)
    label = f"detection threshold at {played.drive.frequency_hz:g} Hz (ESTIMATE)"
    axes.axhline(played.threshold_m_per_s2, color=style.BLACK, lw=1.0, ls="--", label=label)
    _draw_fingers(axes, played)
    _set_axes(axes, played, envelope)
    axes.legend(fontsize="x-small", loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=2)


def _level_text(finger: PlayedFinger) -> str:
    role = "felt" if finger.is_felt else "quiet"
    return f"{role} {finger.level_db:z.1f} dB\n({finger.range_db[0]:z.0f} to {finger.range_db[1]:z.0f})"


def _draw_envelope(axes: Axes, played: PlayedDrive, envelope: Envelope) -> None:
    style.draw_zone_names(axes, played.device)
    place_mm = 1e3 * envelope.position_m
    label = f"least to greatest of {len(played.figures.loads) - 1} other touches"
    axes.fill_between(place_mm, envelope.least, envelope.greatest, color=style.BLUE, alpha=0.15, lw=0, label=label)
    axes.plot(place_mm, envelope.standard, color=style.BLUE, lw=1.8, label="with standard fingers")
    style.draw_actuators(axes, played.device)


def _draw_fingers(axes: Axes, played: PlayedDrive) -> None:
    axes.plot([], [], "o", ms=7, color=style.BLACK, label="standard finger, its level (least to greatest of touches)")
    for finger in played.fingers:
        place_mm, height = 1e3 * finger.position_m, finger.acceleration_m_per_s2
        axes.plot(place_mm, height, "o", ms=9, mec="white", color=style.ROLE_COLOUR[finger.is_felt], zorder=4)
        axes.annotate(
            _level_text(finger),
            (place_mm, height),
            xytext=(0, 9),
            textcoords="offset points",
            ha="center",
            fontsize="small",
            bbox={"boxstyle": "round,pad=0.15", "fc": "white", "ec": "none", "alpha": 0.8},
            zorder=5,
        )


def _set_axes(axes: Axes, played: PlayedDrive, envelope: Envelope) -> None:
    reference = played.threshold_m_per_s2
    under = [finger.acceleration_m_per_s2 for finger in played.fingers]
    lowest = min([_BELOW_THRESHOLD * reference, *(value / 2 for value in under if value)])
    axes.set(
        xlabel="along the bar (mm)",
        ylabel="peak acceleration (m/s²)",
        xlim=(0, 1e3 * played.device.surface.length_m),
        yscale="log",
        ylim=(lowest, _HEADROOM * envelope.greatest.max()),
    )
    levels = axes.secondary_yaxis(
        "right",
        functions=(
            lambda value: 20 * np.log10(np.maximum(np.asarray(value, dtype=float), 1e-9) / reference),
            lambda level_db: reference * 10 ** (np.asarray(level_db, dtype=float) / 20),
        ),
    )
    levels.set_yscale("linear")
    levels.set_ylabel("sensation level (dB above threshold)")


def _drive_text(played: PlayedDrive) -> str:
    drive = played.drive
    parts = [
        f"{actuator.name} {100 * amplitude:.3g} %, {phase:+z.2f} rad" if amplitude else f"{actuator.name} still"
        for actuator, amplitude, phase in zip(played.device.actuators, drive.amplitudes, drive.phases_rad, strict=True)
    ]
    return textwrap.fill(f"solved for these positions at {drive.frequency_hz:g} Hz: {'; '.join(parts)}", _TITLE_LETTERS)


def _promise_text(played: PlayedDrive) -> str:
    figures, worst_db = played.figures, played.worst_contrast_db
    reached = "" if played.drive.achieved else f"NOT ACHIEVED, {played.drive.weakest_felt_db:.1f} dB at most; "
    if worst_db is None:
        return f"{reached}localized factor {played.localized_factor:.3f}"
    contrasts = f"expected {figures.expected_contrast_db:z.1f}, worst {worst_db:z.1f}"
    return f"{reached}contrast {figures.contrast_db:z.1f} dB ({contrasts})"


def _columns(envelope: Envelope) -> dict[str, Array]:
    return {
        **style.position_columns(envelope.position_m),
        "peak acceleration under standard fingers (m/s^2)": envelope.standard,
        "least over sampled touches (m/s^2)": envelope.least,
        "greatest over sampled touches (m/s^2)": envelope.greatest,
    }


def _summary(played: PlayedDrive) -> dict[str, object]:
    named, figures, drive = placement_json(played.device, played.placement), played.figures, played.drive
    return {
        **zone_lists(played.device, played.placement),
        "wanted_level_db": drive.wanted_level_db,
        "level_db": drive.weakest_felt_db,
        "achieved": drive.achieved,
        "contrast_db": figures.contrast_db,
        "expected_contrast_db": figures.expected_contrast_db,
        "worst_contrast_db": played.worst_contrast_db,
        "localized_factor": played.localized_factor,
        "threshold_m_per_s2": {str(drive.frequency_hz): played.threshold_m_per_s2},
        "fingers": [
            {
                **name,
                "acceleration_at_finger_m_per_s2": finger.acceleration_m_per_s2,
                "sensation_level_db": finger.level_db,
                "sensation_level_range_db": finger.range_db,
            }
            for name, finger in zip(named, played.fingers, strict=True)
        ],
    }
