"""Time course of a click: the weighted acceleration of every finger, in the nominal and in the sampled plants."""

from dataclasses import dataclass

import numpy as np

from base.arrays import Array
from engine.table import ClickEntry
from engine.touch import Placement
from precompute.clicks.click_basis import EVALUATION_RATE_HZ, interpolated
from precompute.clicks.evaluation import decibels
from tactable.explain.click_source import ClickSource


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
