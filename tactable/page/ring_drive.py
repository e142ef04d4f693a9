"""Turns ring records into the drive events that their commands cause, for a device that does not report them."""

import math
from collections.abc import Iterable, Sequence

from engine.loop.command_latency import Stage
from engine.loop.ring import Record
from engine.render.board_fit import scales_for
from engine.table import Table
from firmware_link.emulator.drive_log import Cause, ChannelTarget, DriveEvent, PlayedWaveform
from firmware_link.protocol.messages import decode_drive
from tactable.rig.solved_click import SolvedClick

_NS_PER_US = 1000


class RingDrive:
    """Follows the commands of one run of a table.

    `full_scales_m` are those of the board, by actuator; None: those of the table. Every written command is taken as
    driven: lost and late frames are not known. A click that was solved beside the run is the sum that its PLAY asks
    for, of the table's basis, which is the board's but for its full scale.
    """

    def __init__(
        self, table: Table, frequency_resolution_hz: float, full_scales_m: Sequence[float] | None = None
    ) -> None:
        self._table, self._resolution_hz = table, frequency_resolution_hz
        self._limits, self._actuators = table.device.limits, len(table.device.actuators)
        # Commands are fractions of the board's full scale, and the bar of the page moves by those of the table.
        self._scales = (1.0,) * self._actuators if full_scales_m is None else scales_for(table.device, full_scales_m)
        self.halvings = max(0, math.ceil(math.log2(max(self._scales))))
        """How many times the functions of the board's basis are halved."""
        self._drive = b""

    def events(self, records: Iterable[Record]) -> list[DriveEvent]:
        """Drive events in the order of their times, microseconds of the host's clock."""
        found = (self._event(record) for record in records)
        return [event for event in found if event is not None]

    def _event(self, record: Record) -> DriveEvent | None:
        before, self._drive = self._drive, record.drive
        is_sent = record.drive_sequence is not None
        if not is_sent and not (before and not record.drive):  # where the port is lost, silence has no sequence
            return None
        time_us = (record.stamps_ns[Stage.WRITTEN] or record.time_ns) // _NS_PER_US
        waveform = self._waveform(record) if is_sent else None
        cause = Cause.SET if waveform is None else Cause.PLAY
        channels = self._channels(record.drive)
        return DriveEvent(time_us, cause, record.drive_sequence, self._limits.slew_per_s, channels, waveform)

    def _waveform(self, record: Record) -> PlayedWaveform | None:
        if record.level_db is None or record.placement is None or not record.is_click or record.drive:
            return None
        click = self._table.click_at(record.placement, record.level_db)
        if click is None:
            return self._solved(record.play)
        return PlayedWaveform.of(click.sample_rate_hz, click.samples, click.amplitude)

    def _solved(self, play: bytes) -> PlayedWaveform | None:
        """The waveform of a PLAY; None for one of a set that the table's basis does not have."""
        click = SolvedClick.of(play, self._table.clicks.basis, self._actuators, self.halvings)
        return None if click is None else PlayedWaveform.of(click.basis.sample_rate_hz, click.samples, click.amplitude)

    def _channels(self, drive: bytes) -> tuple[ChannelTarget, ...]:
        limit = self._limits.amplitude
        channels = decode_drive(drive, self._resolution_hz)[: self._actuators]
        if not channels:
            return (ChannelTarget(0.0, 0.0, None, limit),) * self._actuators
        return tuple(
            ChannelTarget(c.frequency_hz, c.amplitude / scale, c.phase_rad if c.amplitude else None, limit)
            for c, scale in zip(channels, self._scales, strict=True)
        )
