"""Rivals of a click: the waveforms of other objectives for its fingers and length, evaluated on the same plants."""

from dataclasses import dataclass

from engine.table import ClickEntry
from precompute.clicks import Click
from precompute.clicks.baselines import BASELINES
from tactable.explain.click_source import ClickSource

_TIE_DB = 0.05  # half of the last digit that is shown


@dataclass(frozen=True, eq=False)
class Rival:
    """A waveform as loud as limits and quiet level allow; `lost_by` says by how much it is worse."""

    name: str
    click: Click
    lost_by: str


def solve_rivals(source: ClickSource, click: ClickEntry) -> list[Rival]:
    """Evaluate every baseline against a click at full strength that the source solved."""
    rivals = {name: source.solve_baseline(click.placement, name) for name in BASELINES}
    return [Rival(name, rival, _lost_by(click, rival)) for name, rival in rivals.items()]


def _lost_by(click: ClickEntry, rival: Click) -> str:
    less_db = click.felt.low_db - rival.evaluation.felt.low_db
    if abs(less_db) > _TIE_DB:
        return f"{abs(less_db):.1f} dB {'less' if less_db > 0 else 'MORE'} felt"
    if click.quiet is None or rival.evaluation.quiet is None:
        return "as strong"
    more_db = rival.evaluation.quiet.high_db - click.quiet.high_db
    return f"as strong, {abs(more_db):.1f} dB {'less' if more_db > 0 else 'MORE'} quiet"
