"""Laws of promises in events: those of the table for clicks, those of the drive that was sent for steady drives."""

import math
from dataclasses import replace

import numpy as np
import pytest

from engine.render.board_fit import RendererError
from engine.table import Table
from engine.touch import Placement
from firmware_link.protocol.drive_words import decode_drive, encode_drive
from tactable.control.events import Board, Events, promise_of
from tactable.explain.placed_drive import designer_of
from tests.tactable.control.messages import SAID
from tests.tactable.page.played import RESOLUTION_HZ, record_of

FINGERS = Placement((0.035, 0.22), (True, False))
AT_NS = 1_000_000


def board_of(table: Table, times: float = 1.0) -> Board:
    return Board(RESOLUTION_HZ, tuple(times * actuator.full_scale_m for actuator in table.device.actuators))


def test_a_steady_drive_promises_what_explain_says_of_these_positions(table: Table) -> None:
    promise = promise_of(table, record_of(table, FINGERS, AT_NS), board_of(table))
    figures = designer_of(table).solve(FINGERS.position_m, FINGERS.is_felt, 20.0)
    assert promise is not None and figures.spread.quiet is not None
    felt, quiet = figures.spread.felt, figures.spread.quiet
    assert list(promise["felt_db"].values()) == pytest.approx(
        [figures.level_db[0], felt.low_db, felt.middle_db, felt.high_db], abs=0.2
    )
    assert list(promise["quiet_db"].values()) == pytest.approx(
        [figures.level_db[1], quiet.low_db, quiet.middle_db, quiet.high_db], abs=0.2
    )
    assert promise["felt_at_least_db"] == promise["felt_db"]["5 %"]
    assert promise["quiet_at_most_db"] == promise["quiet_db"]["95 %"]
    assert promise["is_achieved"] and promise["threshold"] == table.device.threshold.title
    alone = promise_of(table, record_of(table, Placement((0.1,), (True,)), AT_NS), board_of(table))
    assert alone is not None and alone["quiet_db"] is None and alone["quiet_at_most_db"] is None


def test_it_is_of_the_bytes_that_were_sent_and_of_the_board_that_got_them(table: Table) -> None:
    record, placed = record_of(table, FINGERS, AT_NS), board_of(table)
    weaker = [
        replace(channel, amplitude=channel.amplitude / 2) for channel in decode_drive(record.drive, RESOLUTION_HZ)
    ]
    halved = record._replace(drive=encode_drive(weaker, RESOLUTION_HZ))
    first, second, third = (
        promise_of(table, each, board)
        for each, board in ((record, placed), (halved, placed), (halved, board_of(table, 2.0)))
    )
    assert first is not None and second is not None and third is not None
    six_db = 20 * math.log10(2)
    assert second["felt_db"]["50 %"] == pytest.approx(first["felt_db"]["50 %"] - six_db, abs=1e-2)
    assert not second["is_achieved"]
    # A board that moves twice as far plays the same words as the table's own drive.
    assert third["felt_db"]["50 %"] == pytest.approx(first["felt_db"]["50 %"], abs=1e-2)
    with pytest.raises(RendererError, match="connect the board of"):
        promise_of(table, record, board_of(table, 100.0))


def test_a_click_promises_what_the_table_has(table: Table) -> None:
    click = table.click_at(FINGERS, 20.0)
    promise = promise_of(table, record_of(table, FINGERS, AT_NS, is_click=True), None)
    assert click is not None and promise is not None and click.quiet is not None
    assert promise["felt_at_least_db"] == click.felt.low_db and promise["quiet_at_most_db"] == click.quiet.high_db
    three = Placement((0.03, 0.1, 0.2), (True, False, False))
    assert promise_of(table, record_of(table, three, AT_NS, is_click=True), board_of(table)) is None


def test_of_drives_that_are_read_at_once_the_last_has_a_promise_and_nobody_waits_for_one_unasked(table: Table) -> None:
    placements = [Placement((at_m, 0.22), (True, False)) for at_m in np.linspace(0.03, 0.06, 4).tolist()]
    records = [
        *(record_of(table, placement, AT_NS) for placement in placements),
        record_of(table, placements[-1], AT_NS)._replace(drive_sequence=None),  # the drive goes on
        record_of(table, FINGERS, AT_NS, level_db=None),
        record_of(table, FINGERS, AT_NS, is_click=True),
    ]
    events = Events(table, lambda _position_m, _zone: None)
    events.board = board_of(table)
    for has_promises in (True, False):
        said = [each for each in events.read(records, has_promises=has_promises) if each["event"] == "played"]
        for each in said:
            SAID.validate(each)
        expected = [False, False, False, True, False, True] if has_promises else 6 * [False]
        assert [each["promise"] is not None for each in said] == expected
