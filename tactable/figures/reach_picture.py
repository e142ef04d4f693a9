"""The dead zones of a device: the greatest acceleration and level that each place can be given."""

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from base.arrays import Array
from engine.device import Device
from engine.device.quantity import GRAVITY_M_PER_S2
from precompute.model.assembly import assemble
from precompute.studies.reach_along import Reach, compute_reach
from tactable.figures import style
from tactable.figures.picture_file import Picture

PLACES = 141  # 2 mm apart on 280 mm, closer than a fingertip is wide; 21 mm on a tablet
PAPER_G = 1.5  # the published bar: "a peak acceleration greater than 1.5 g can be achieved throughout"
_FLOOR, _LEGEND_ROOM = 0.4, 4.0  # of the least and of the greatest value


def plot_reach(device: Device) -> Picture:
    """Picture of a device: untouched, and under a standard finger that lies at each place in turn."""
    plant, place_m = assemble(device), style.surface_field(device, PLACES).position_m
    untouched, touched = compute_reach(plant, place_m), compute_reach(plant, place_m, device.finger)
    if style.is_plate(device):
        figure = Figure(figsize=(9, 1.4 + 2 * style.map_height(device, 4.6)), layout="constrained")
        above, below = figure.subplots(2, 1)
        field = style.surface_field(device, PLACES)
        style.draw_map(above, device, field, touched.tones, "greatest peak under\na finger there (m/s²)", vmin=0.0)
        label = f"greatest level under a finger\nthere (dB {device.threshold.above})"
        style.draw_map(below, device, field, touched.level_db, label)
    else:
        figure = Figure(figsize=(9, 6.6), layout="constrained")
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=[3, 2])
        _draw_accelerations(above, device, untouched, touched)
        _draw_level(below, device, touched)
    return style.finish_picture(
        figure,
        device,
        f"{device.name}: greatest acceleration at each place, full scale",
        _least_text(untouched, touched),
        _columns(device, untouched, touched),
        {
            "untouched": _least(untouched),
            "under_a_finger": {**_least(touched), "least_level_db": float(touched.level_db.min())},
        },
        subtitle=_least_text(untouched, touched),
    )


def _draw_accelerations(axes: Axes, device: Device, untouched: Reach, touched: Reach) -> None:
    place_mm = 1e3 * untouched.position_m.real
    curves = (
        (untouched.tones, style.BLUE, "-", "untouched, each actuator at its best frequency"),
        (untouched.one_tone, style.GREEN, "--", "untouched, all at one frequency"),
        (touched.tones, style.VERMILLION, "-.", "under a standard finger lying there"),
    )
    for reach, colour, ls, label in curves:
        axes.plot(place_mm, reach, color=colour, ls=ls, lw=1.6, label=label)
    paper = PAPER_G * GRAVITY_M_PER_S2
    axes.axhline(paper, color=style.BLACK, ls=":", lw=1.2, label=f"{PAPER_G:g} g, the published bar")
    greatest = max(float(reach.max()) for reach, *_ in curves)
    least = min(float(touched.tones.min()), paper)
    axes.set(yscale="log", ylabel="greatest peak\nacceleration (m/s²)", ylim=(_FLOOR * least, _LEGEND_ROOM * greatest))
    style.draw_gravities(axes)
    style.draw_zone_names(axes, device)
    style.draw_actuators(axes, device)
    axes.legend(fontsize="x-small", loc="upper center", bbox_to_anchor=(0.5, 0.93), ncols=2)


def _draw_level(axes: Axes, device: Device, touched: Reach) -> None:
    axes.plot(1e3 * touched.position_m.real, touched.level_db, color=style.VERMILLION, ls="-.", lw=1.6)
    for level_db in device.levels_db:
        axes.axhline(level_db, color=style.GREY, lw=0.8, ls=":")
        text, beside = f"rows at {level_db:g} dB", axes.get_yaxis_transform()
        axes.text(0.995, level_db, text, fontsize="x-small", color="dimgrey", va="bottom", ha="right", transform=beside)
    axes.set(
        xlabel="along the bar (mm)",
        ylabel="greatest level under a\nfinger (dB above threshold)",
        xlim=(0, 1e3 * device.surface.length_m),
        ylim=(0, None),
    )
    style.draw_zone_edges(axes, device)


def _least_text(untouched: Reach, touched: Reach) -> str:
    return (
        f"at least {_least_g(untouched):.2f} g untouched, "
        f"{_least_g(touched):.2f} g and {touched.level_db.min():.1f} dB under a finger"
    )


def _least_g(reach: Reach) -> float:
    return float(reach.tones.min()) / GRAVITY_M_PER_S2


def _columns(device: Device, untouched: Reach, touched: Reach) -> dict[str, Array]:
    columns = style.position_columns(untouched.position_m)
    for name, reach in (("untouched", untouched), ("under a finger there", touched)):
        columns[f"each actuator at its best frequency, {name} (m/s^2)"] = reach.tones
        for actuator, hz in zip(device.actuators, reach.tones_hz.T, strict=True):
            columns[f"best frequency of {actuator.name}, {name} (Hz)"] = hz
        columns[f"all at one frequency, {name} (m/s^2)"] = reach.one_tone
        columns[f"best common frequency, {name} (Hz)"] = reach.one_tone_hz
    columns["greatest level under a finger there (dB above threshold)"] = touched.level_db
    return columns


def _least(reach: Reach) -> dict[str, complex]:
    at = int(reach.tones.argmin())
    return {
        "least_m_per_s2": float(reach.tones[at]),
        "least_position_m": reach.position_m[at].item(),
        "least_at_one_frequency_m_per_s2": float(reach.one_tone.min()),
    }
