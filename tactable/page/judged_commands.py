"""Ring records to commands as the page judges them: what was sent, for which fingers, and what they were promised."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from base.arrays import Array
from engine.effects.effect_player import DEFAULT_CLICK_NS
from engine.loop.observer import Stage
from engine.loop.ring import Record
from engine.table import ClickEntry, Table
from engine.touch import Placement, Touch
from engine.touch.placement import CLOSEST_M
from firmware_link.emulator.synthesis import US_PER_S
from firmware_link.protocol.drive_words import ChannelDrive, decode_drive
from tactable.page.page_messages import ChannelPicture, Drive, Role
from tactable.rig.promises import Promises, SolvedClick

RINGING_S = 0.06  # time after its end in which a click rings down by some 20 dB


@dataclass
class Command:
    """A drive or click that was sent. Times are those of the device.

    fingers: by contact, the index of the finger of the placement that it is; promised_db (finger,), None: not known.
    """

    number: int
    placement: Placement
    fingers: dict[int, int]
    at_us: float
    wanted_db: float
    drive: Drive
    channels: tuple[ChannelPicture, ...]
    promised_db: Sequence[float | None]
    played: ClickEntry | Sequence[ChannelDrive] | None
    """The click, or the drive of each actuator; None: a click that is not known."""
    length_s: float  # length of a click; infinite for a steady drive
    ended_us: float
    sequence: int | None  # sequence number of its frame
    is_stalled: bool = False  # whether a part of its time was left out, the machine having stalled
    spread_db: Array | None = None
    """Shape (2, finger): what sampled bars give, 5th and 95th percentile; None: not computed."""
    is_mixed: bool = False  # whether one of its quiet fingers still felt a click or a drive of its own when it began

    def role(self, finger: int) -> Role:
        """Role of a finger in the placement of the command."""
        return Role.FELT if self.placement.is_felt[finger] else Role.QUIET

    def cuts(self, before: "Command | None") -> bool:
        """Whether a quiet finger of this click still feels the command before it, in which it was a felt finger."""
        if before is None or self.drive is not Drive.CLICK:
            return False
        felt = {number for number, finger in before.fingers.items() if before.placement.is_felt[finger]}
        quiet = {number for number, finger in self.fingers.items() if not self.placement.is_felt[finger]}
        is_click = before.drive is Drive.CLICK
        over_us = before.at_us + before.length_s * US_PER_S if is_click else before.ended_us
        return self.at_us < over_us + RINGING_S * US_PER_S and bool(felt & quiet)


class CommandReader:
    """Makes the commands of one table. The promise of a steady drive is what the one that was sent gives to fingers."""

    def __init__(self, table: Table, frequency_resolution_hz: float, *, halvings: int = 0) -> None:
        self._table, self._resolution_hz = table, frequency_resolution_hz
        self.solved = list[Placement]()  # the placements whose clicks the table does not hold and that were played
        self._promises, self._count, self._halvings = Promises(table), 0, halvings
        self._promises.prepare()
        self._click_length_s = max((click.length_s for click in table.clicks[:1]), default=DEFAULT_CLICK_NS / 1e9)

    def command_of(self, record: Record, zero_ns: int) -> Command | None:
        """The command that a record begins; None for silence. `zero_ns` is host time at the device's zero."""
        placement, level_db = record.placement, record.level_db
        if placement is None or level_db is None:
            return None
        self._count += 1
        is_click = record.is_click and not record.drive
        made = (self._click if is_click else self._drive)(record, placement, level_db)
        channels, promised_db, length_s, played = made
        at_us = time_of(record, zero_ns)
        return Command(
            number=self._count,
            placement=placement,
            fingers=_fingers_of(record.touches, placement),
            at_us=at_us,
            wanted_db=level_db,
            drive=Drive.CLICK if is_click else Drive.STEADY,
            channels=channels,
            promised_db=promised_db,
            played=played,
            length_s=length_s,
            ended_us=at_us + length_s * US_PER_S,
            sequence=record.drive_sequence,
        )

    def _click(self, record: Record, placement: Placement, level_db: float) -> "_Made":
        actuators = len(self._table.device.actuators)
        found = self._promises.of_tabulated_click(placement, level_db)
        if found is None:
            solved = SolvedClick.of(record.play, self._table.clicks.basis, actuators, self._halvings)
            if solved is None:
                return (), (None,) * len(placement.position_m), self._click_length_s, None
            if placement not in self.solved:
                self.solved.append(placement)
            found = self._promises.of_solved_click(placement, solved)
        click, promise = found
        channels = (ChannelPicture(0.0, click.amplitude, 0.0),) * actuators
        return channels, promise.level_db.tolist(), click.length_s, click

    def _drive(self, record: Record, placement: Placement, _: float) -> "_Made":
        drive = decode_drive(record.drive, self._resolution_hz)[: len(self._table.device.actuators)]
        channels = tuple(ChannelPicture(c.frequency_hz, c.amplitude, c.phase_rad) for c in drive)
        return channels, self._promises.of_channels(placement, drive).tolist(), math.inf, drive


_Made = tuple[tuple[ChannelPicture, ...], Sequence[float | None], float, ClickEntry | Sequence[ChannelDrive] | None]
"""Channels, promised levels and length of a command, and what is played."""


def time_of(record: Record, zero_ns: int) -> float:
    """Time at which the command of a record was written, in microseconds of the device."""
    return ((record.stamps_ns[Stage.WRITTEN] or record.time_ns) - zero_ns) / 1e3


def _fingers_of(touches: Iterable[Touch], placement: Placement) -> dict[int, int]:
    """The index of the nearest finger of a placement, by contact; a contact without one that is near is absent."""
    found = dict[int, int]()
    for touch in touches:
        distance_m, finger = min((abs(at_m - touch.position_m), k) for k, at_m in enumerate(placement.position_m))
        if distance_m < CLOSEST_M:
            found[touch.contact_id] = finger
    return found
