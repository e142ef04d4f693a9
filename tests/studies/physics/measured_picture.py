"""The picture of the public measured bars in theory.md: what was measured, against the fitted model.

    python -m tests.studies.physics.measured_picture docs/figures/measured.png

The bars are read from beside the repository (tests/precompute/measured_bars.py). It prints the figures of the page too.
"""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from base.arrays import Array
from precompute.model.modal import compute_modes
from tactable.figures import style
from tests.precompute.fitted_bars import beam_calibration, cantilever_misses, fitted_beam, fitted_ruler
from tests.precompute.measured_bars import CANTILEVER_HZ
from tests.studies.options import read_options


def draw() -> Figure:
    """Responses of the beam, shapes of the ruler, and the misses of every natural frequency."""
    figure = Figure(figsize=(10, 8.4), layout="constrained")
    above, below = figure.subplots(2, 1, height_ratios=(1, 1.15))
    found = beam_calibration()
    rows = found.measurements.position_m == found.measurements.position_m[0]
    hz = np.nanmax(found.measurements.frequency_hz, axis=1)[rows]
    for value, name, (colour, line) in zip(
        (found.measurements.acceleration, found.predicted), ("measured", "model"), style.CURVES, strict=False
    ):
        above.plot(hz, 20 * np.log10(abs(value[rows])), color=colour, ls=line, lw=1.2, label=name)
    above.set(xlabel="frequency (Hz)", ylabel="accelerance (dB, scale unstated)", xlim=(20, 1000))
    above.set_title("free beam, from 0.027 to 0.973 of its length (pyuff)", fontsize="medium")
    above.legend(loc="lower right")
    left, right = below.get_subplotspec().subgridspec(1, 2, width_ratios=(1.6, 1)).subplots()
    below.remove()
    draw_shapes(left)
    draw_misses(right)
    return figure


def draw_shapes(axes: Axes) -> None:
    """The ruler's four shapes at ten points, and those of the model."""
    ruler = fitted_ruler()
    place_m = np.linspace(0, ruler.fit.device.surface.length_m, 121)
    fine = compute_modes(ruler.fit.device, place_m, 460)
    coarse = compute_modes(ruler.fit.device, ruler.place_m, 460)
    for k, (shape, hz) in enumerate(zip(ruler.shape, ruler.fit.fitted_hz, strict=True)):
        nearest = int(np.argmin([abs(mode.frequency_hz - hz) for mode in fine]))
        own, here = fine[nearest].shape, coarse[nearest].shape
        scale = np.vdot(shape, here) / np.vdot(shape, shape)
        colour = style.CURVES[k][0]
        size = 2.6 * abs(own).max()
        axes.plot(1e3 * place_m, own / size - k, color=colour)
        axes.plot(1e3 * ruler.place_m, (scale * shape).real / size - k, "o", color=colour)
        label = f"{ruler.fit.modes.frequency_hz[k]:.1f} Hz, MAC {ruler.fit.assurance[k]:.3f}"
        axes.text(4, 0.42 - k, label, fontsize="small")
    axes.set(xlabel="along a ruler taken for 300 mm", yticks=[])
    axes.set_title("ruler, ten points (pydvma): measured (discs), model", fontsize="medium")


def draw_misses(axes: Axes) -> None:
    """How far each measured frequency lies from the model's."""
    bars: list[tuple[str, Array]] = [
        ("free beam", 100 * fitted_beam().fit.off[0]),
        ("ruler", 100 * fitted_ruler().fit.off[0]),
        ("cantilever (clamp ideal)", 100 * (1 / (1 + cantilever_misses()) - 1)),
    ]
    for k, (name, off) in enumerate(bars):
        axes.plot(np.arange(1, len(off) + 1), off, "o-", color=style.CURVES[k][0], label=name)
    axes.axhline(0, color=style.GREY, lw=0.6)
    axes.set(xlabel="mode", ylabel="measured above the model (%)", ylim=(-9, 2))
    axes.set_title("natural frequencies", fontsize="medium")
    axes.legend(loc="center right", fontsize="small")


def main() -> None:
    """Write the picture and print the figures."""
    asked = read_options(__doc__, path=str)
    draw().savefig(asked.path, dpi=100)
    for name, bar in (("beam", fitted_beam()), ("ruler", fitted_ruler())):
        fit = bar.fit
        rows = zip(fit.modes.frequency_hz, 100 * fit.off[0], 200 * fit.modes.damping_ratio, fit.assurance, strict=True)
        print(
            name,
            *(f"{hz:.2f} Hz ({off:+.2f} %), loss {loss:.3f} %, MAC {mac:.4f}" for hz, off, loss, mac in rows),
            sep="\n  ",
        )
    found = beam_calibration()
    ratio = found.measurements.acceleration / found.predicted
    off_db = abs(20 * np.log10(abs(ratio)))
    turned_deg = np.degrees(np.median(abs(np.angle(ratio))))
    print(f"beam's responses: {np.percentile(off_db, (50, 90, 99)).round(2)} dB, {turned_deg:.2f} deg")
    print("cantilever", CANTILEVER_HZ, "Hz, model above by", (100 * cantilever_misses()).round(2), "%")


if __name__ == "__main__":
    main()
