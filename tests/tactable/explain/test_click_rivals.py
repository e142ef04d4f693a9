"""Laws of the clicks that lost: judged as the winner is, and they say what they are short of."""

from dataclasses import replace

import pytest

from engine.table import ClickEntry
from engine.table.levels import shifted
from engine.touch import Placement
from precompute.clicks.baselines import BASELINES
from tactable.explain.click_source import ClickSource
from tactable.explain.explained_click import solve_rivals


@pytest.fixture(scope="module")
def click(source: ClickSource) -> ClickEntry:
    return source.solve(Placement.named(source.table.device, ["I"], ["III"]))


def test_every_baseline_is_judged_at_the_length_of_the_click(source: ClickSource, click: ClickEntry) -> None:
    rivals = solve_rivals(source, click)
    assert [rival.name for rival in rivals] == list(BASELINES)
    for rival in rivals:
        assert rival.click.waveform.shape == click.samples.T.shape
        assert abs(rival.click.waveform).max() <= source.table.device.limits.amplitude
        assert rival.lost_by == f"{click.felt.low_db - rival.click.evaluation.felt.low_db:.1f} dB less felt"


def test_what_does_not_lose_says_so(source: ClickSource, click: ClickEntry) -> None:
    rival = solve_rivals(source, click)[0].click.evaluation
    assert rival.quiet is not None and click.quiet is not None
    weaker = replace(click, felt=shifted(click.felt, rival.felt.low_db - click.felt.low_db - 1.0))
    assert solve_rivals(source, weaker)[0].lost_by == "1.0 dB MORE felt"
    quieter = shifted(click.quiet, rival.quiet.high_db - click.quiet.high_db - 2)
    as_strong = replace(weaker, felt=shifted(weaker.felt, 1.0), quiet=quieter)
    assert solve_rivals(source, as_strong)[0].lost_by == "as strong, 2.0 dB less quiet"
    assert solve_rivals(source, replace(as_strong, quiet=None))[0].lost_by == "as strong"
