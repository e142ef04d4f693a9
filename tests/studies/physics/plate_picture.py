"""The picture of a plate in the README: a click of five fingers, one of which feels, and its level all over the plate.

    python -m tests.studies.physics.plate_picture docs/figures/plate.png

The click is solved for where the fingers are; its levels are those of the nominal plate with standard fingers.
"""

import numpy as np
from matplotlib.figure import Figure

from engine.device import Device
from engine.touch import Placement
from precompute.clicks import DEFAULT_OPTIONS, ClickSolver
from precompute.clicks.click_basis import RINGDOWN_S, SAMPLE_RATE_HZ
from precompute.clicks.evaluation import decibels
from precompute.model.assembly import assemble
from precompute.model.modal import compute_basis
from precompute.model.transfers import threshold_filter
from precompute.model.transient import TransientPlant
from tactable.figures import style
from tactable.shipped import find_device
from tests.studies.options import read_options

FELT, QUIET = ["105 x 62 mm"], ["45 x 135 mm", "165 x 140 mm", "205 x 55 mm", "262 x 118 mm"]
_STEPS = 4
"""Steps for each sample: a peak at 300 Hz is missed by less than 0.02 dB."""


def draw(device: Device, placement: Placement) -> Figure:
    """The plate from above, with the level of the click of a placement at every point, and under its fingers."""
    click = ClickSolver(device, DEFAULT_OPTIONS.at_fingers).solve(placement)
    field = style.surface_field(device)
    points_m = np.concatenate([field.position_m, placement.position_m])
    plant = TransientPlant(compute_basis(assemble(device)), points_m, _STEPS * SAMPLE_RATE_HZ)
    plant.touch([(at_m, device.finger) for at_m in placement.position_m])
    samples = np.arange(len(click.waveform))
    at = np.arange(_STEPS * samples[-1] + 1) / _STEPS
    played = np.column_stack([np.interp(at, samples, each) for each in click.waveform.T])
    course = plant.accelerate(np.pad(played, ((0, round(RINGDOWN_S * plant.sample_rate_hz)), (0, 0))))
    taps = threshold_filter(device.threshold, plant.sample_rate_hz)
    level_db = decibels(np.array([abs(np.convolve(each, taps)[: len(each)]).max() for each in course.T]))
    figure = Figure(figsize=(9, 5.4), layout="constrained")
    axes = figure.subplots()
    style.draw_map(axes, device, field, level_db[: field.count], "peak of the click (dB above threshold)", vmin=0)
    words = {True: "feels", False: "does not"}
    under = zip(placement.is_felt, level_db[field.count :].tolist(), strict=True)
    style.draw_fingers(axes, placement, [f"{words[is_felt]}: {level:z.0f} dB" for is_felt, level in under])
    felt, quiet = click.felt, click.quiet
    assert quiet is not None  # all fingers but one are
    ends = f"{felt.low_db:.1f} dB felt and {quiet.high_db:z.1f} dB quiet"
    title = (
        f"{device.name}: one click on {len(device.actuators)} actuators (triangles), SIMULATED, every value an ESTIMATE"
    )
    axes.set_title(
        f"{title}\n95 % of uncertain plates and fingers: {ends}, by {device.threshold.name}", fontsize="medium"
    )
    return figure


def main() -> None:
    """Write the picture."""
    asked, device = read_options(__doc__, path=str), find_device("reference-p")
    draw(device, Placement.named(device, FELT, QUIET)).savefig(asked.path, dpi=110)


if __name__ == "__main__":
    main()
