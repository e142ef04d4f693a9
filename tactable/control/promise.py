"""What a table promises of a command: the levels of the weakest felt and the strongest quiet finger, with their spread.

- A **click** of the table has its promise there, over sampled bars and fingers.
- A **steady drive** is what the device was sent, so its levels are computed from these bytes and the modes of the
  table, over sampled fingers (engine.steady.given_drive).
- A click that was solved beside the run has none: its spread would take a second.

All of it is computed in the process of the control channel, when a record is read.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from base.arrays import Array
from engine.loop.ring import Record
from engine.render.board_fit import scales_for
from engine.steady.given_drive import CASES, compute_levels
from engine.table import ClickEntry, Table
from engine.touch import Placement
from firmware_link.protocol.messages import decode_drive

SHARE = 0.95  # of the sampled plants: felt fingers reach, and quiet ones keep to, what is promised
_PERCENTS = (5, 50, 95)  # as precompute/predict/at_positions.py
_REACHED_DB = 0.05  # the wire rounds amplitude and frequency: a level this close to the wanted one is reached


@dataclass(frozen=True)
class Board:
    """What the numbers of a SET mean on the connected board; full_scales_m by actuator."""

    frequency_resolution_hz: float
    full_scales_m: tuple[float, ...]


def promise_of(table: Table, record: Record, board: Board | None) -> dict[str, Any] | None:
    """What an event says of the levels that a command promises; None where they cannot be computed in time."""
    placement, level_db = record.placement, record.level_db
    if placement is None or level_db is None:
        return None
    if record.drive:
        return None if board is None else _of_drive(table, record.drive, board, placement, level_db)
    click = table.click_at(placement, level_db) if record.is_click else None
    return None if click is None else _of_click(table, click)


def _of_click(table: Table, click: ClickEntry) -> dict[str, Any]:
    felt, quiet = (
        spread and _levels(spread.nominal_db, spread.low_db, spread.middle_db, spread.high_db)
        for spread in (click.felt, click.quiet)
    )
    return _promise(table, felt, quiet, click.achieved, "sampled bars and fingers")


def _of_drive(table: Table, drive: bytes, board: Board, placement: Placement, level_db: float) -> dict[str, Any]:
    device = table.device
    scales = scales_for(device, board.full_scales_m)
    channels = decode_drive(drive, board.frequency_resolution_hz)[: len(scales)]
    amplitude = np.array(
        [c.amplitude / scale * np.exp(1j * c.phase_rad) for c, scale in zip(channels, scales, strict=True)]
    )
    hz = [channel.frequency_hz for channel in channels]
    found_db = compute_levels(device, table.modes, placement.position_m, hz, amplitude)
    is_felt = np.array(placement.is_felt)
    weakest = found_db[:, is_felt].min(axis=1)
    quiet = None if is_felt.all() else _over_cases(found_db[:, ~is_felt].max(axis=1))
    is_achieved = math.isinf(level_db) or float(weakest[0]) >= level_db - _REACHED_DB
    return _promise(table, _over_cases(weakest), quiet, is_achieved, f"{CASES} cases of sampled fingers")


def _over_cases(level_db: Array) -> dict[str, float]:
    """Levels (case,), the standard case first."""
    return _levels(float(level_db[0]), *np.percentile(level_db[1:], _PERCENTS).tolist())


def _levels(nominal_db: float | None, low_db: float, middle_db: float, high_db: float) -> dict[str, Any]:
    return {"nominal": nominal_db, "5 %": low_db, "50 %": middle_db, "95 %": high_db}


def _promise(table: Table, felt: Any, quiet: Any, is_achieved: bool, over: str) -> dict[str, Any]:
    return {
        "felt_at_least_db": felt["5 %"],
        "quiet_at_most_db": quiet and quiet["95 %"],
        "share_of_plants": SHARE,
        "is_achieved": bool(is_achieved),
        "felt_db": felt,
        "quiet_db": quiet,
        "over": over,
        "threshold": table.device.threshold.title,
    }
