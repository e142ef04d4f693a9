"""Child process that serves the page of a live run, from its ring and table, until the run ends."""

import asyncio
import contextlib
import math
import os
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import uvicorn
from threadpoolctl import threadpool_limits

from base.child import Parent
from base.files import identity_of
from engine.loop.observer import Stage
from engine.loop.ring import Record, RingReader
from engine.render.board_fit import RendererError, scales_for
from engine.table import Table, TableError
from firmware_link.emulator.drive_log import Cause, ChannelTarget, DriveEvent, PlayedWaveform
from firmware_link.protocol.drive_words import decode_drive
from tactable.control.security import listen_at
from tactable.page.live_bar import LiveBar
from tactable.page.opening import announcement, token_for
from tactable.page.page_messages import encode_picture
from tactable.page.page_server import PageBackend, serve
from tactable.page.view import View, device_json
from tactable.rig.promises import SampledPromises, SolvedClick
from tactable.run.table_watch import LOOK_S
from tactable.run.track_status import read_status, track_text

_NS_PER_US = 1000


class RingDrive:
    """Turns ring records into the drive events that their commands cause, for a device that does not report them.

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
        if click is not None:
            return PlayedWaveform.of(click.sample_rate_hz, click.samples, click.amplitude)
        solved = SolvedClick.of(record.play, self._table.clicks.basis, self._actuators, self.halvings)
        if solved is None:  # of a set that the table's basis does not have
            return None
        return PlayedWaveform.of(solved.basis.sample_rate_hz, solved.samples, solved.amplitude)

    def _channels(self, drive: bytes) -> tuple[ChannelTarget, ...]:
        limit = self._limits.amplitude
        channels = decode_drive(drive, self._resolution_hz)[: self._actuators]
        if not channels:
            return (ChannelTarget(0.0, 0.0, None, limit),) * self._actuators
        return tuple(
            ChannelTarget(c.frequency_hz, c.amplitude / scale, c.phase_rad if c.amplitude else None, limit)
            for c, scale in zip(channels, self._scales, strict=True)
        )


BEHIND_NS = 30_000_000  # age of the picture; ring records are written after their command


class LiveBackend(PageBackend):
    """Shows one run; a new table at the same path is adopted, as the run adopts it."""

    def __init__(
        self,
        reader: RingReader,
        table_path: Path,
        frequency_resolution_hz: float,
        full_scales_m: Sequence[float],
    ) -> None:
        self._reader, self._table_path, self._resolution_hz = reader, table_path, frequency_resolution_hz
        self._full_scales_m = tuple(full_scales_m)
        self._identity, self._tracked = identity_of(table_path), ""
        self._take_up(Table.open(table_path, verify=False))

    def _take_up(self, table: Table) -> None:
        self._drive = RingDrive(table, self._resolution_hz, self._full_scales_m)
        self._table = table
        self._view = View(table, LiveBar(table.device), self._resolution_hz, halvings=self._drive.halvings)
        self.scene_number += 1

    def scene(self) -> dict[str, Any]:
        """The part of the state that changes seldom, as JSON values."""
        return {
            "mode": "live",
            "device": device_json(self._table.device),
            "status": "running",
            "trouble": "",
            "restarts": 0,
            "building": None,
            "clicks": len(self._table.clicks),
            "plays": {},
            "choice": {},
            "tracked": self._tracked,
        }

    def tick(self) -> tuple[list[bytes], bool]:
        """Read the ring and advance the bar."""
        records, view = list(self._reader.read()), self._view
        view.read(records)
        view.take_events(self._drive.events(records))
        messages = view.move((time.monotonic_ns() - BEHIND_NS) / _NS_PER_US, is_loaded=True)
        picture = view.picture()
        return [*messages, encode_picture(picture)], bool(picture.fingers) or view.ours.is_moving

    def sound(self, finger: int) -> bytes | None:
        """Vibration that a finger felt, as a SOUND message."""
        return self._view.sound(finger)

    async def run(self) -> None:
        """Watch for another table until cancelled."""
        while True:
            with contextlib.suppress(TableError):  # clicks of options that are not known here
                if self._view.spreads is None and self._table.clicks:
                    self._view.spreads = await asyncio.to_thread(SampledPromises, self._table)
            await asyncio.sleep(LOOK_S)
            if (tracked := track_text(read_status(self._table_path))) != self._tracked:
                self._tracked = tracked
                self.scene_number += 1
            with contextlib.suppress(
                OSError, TableError, RendererError
            ):  # being replaced, or not usable: the run ignores it too
                found = identity_of(self._table_path)
                if found != self._identity:
                    self._identity = found
                    table = await asyncio.to_thread(Table.open, self._table_path)
                    before = self._table
                    self._take_up(table)
                    before.close()


_NICE = 5  # a third of the share of a busy engine: 1.25 for each step, sched(7)


def main(parent: Parent, arguments: dict[str, Any]) -> None:
    """Say the address of the page, then serve it until the run ends."""
    os.nice(_NICE)  # the engine comes first
    with RingReader(Path(arguments["ring"])) as reader:
        board = arguments["frequency_resolution_hz"], arguments["full_scales_m"]
        backend = LiveBackend(reader, Path(arguments["table"]), *board)
        with threadpool_limits(1, "blas"):  # its threads spin on a busy machine
            asyncio.run(_serve(backend, arguments["host"], arguments["port"], parent))


async def _serve(backend: LiveBackend, host: str, port: int, parent: Parent) -> None:
    listening, access = listen_at(host, port, token_for(port))
    with listening:
        parent.say({"lines": announcement(access)})

        async def end_with_run(server: uvicorn.Server) -> None:
            loop = asyncio.get_running_loop()

            def end() -> None:
                loop.remove_reader(parent.fileno())
                server.should_exit = True

            loop.add_reader(parent.fileno(), end)  # the run says nothing but its end

        await serve(backend, listening, access, end_with_run)
