"""Follows a run from beside it: samples and touches to the drift, and a table of the surface as it has become.

Theory of operation. The loop must not be loaded, so all of this is a child process. It reads the touches from the ring
of the run. It reads a sound card or a pipe of samples itself. Only the link of the run can read the board's own
accelerometer, so the loop passes each frame on, and drops it where the pipe is full. The run plays a copy of its table
in a folder of its own. A table of the measured device is built in its place, and the run adopts it as it adopts any
other (table_watch). What is known is a small file beside it.
"""

import contextlib
import json
import os
import select
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from threadpoolctl import threadpool_limits

from base.child import Parent, decode_line
from base.errors import TactableError
from base.files import identity_of, write_text
from base.printable import write_note
from engine.device import Device
from engine.device.quantity import QuantityError, read_point_on, read_quantity
from engine.loop.loop import SystemClock
from engine.loop.ring import RingReader
from engine.steady.cases import MeasuredFinger
from engine.table import Table, TableError
from firmware_link.host.link_values import AccelerometerDescribed, Capabilities, Event
from firmware_link.protocol.messages import Acceleration
from tactable.measure.board_sensor import BoardSensor, is_board
from tactable.measure.sensor import Sensor, SensorError
from tactable.run.beside_loop import BesideLoop
from tactable.run.track_status import STATUS

if TYPE_CHECKING:  # the tracker needs scipy, which the run does not
    from tactable.measure.sensor import SampleStream
    from tactable.track.tracker import Tracker

_NAME = "tracking"
_NICE, _LOOK_S = 10, 0.05  # the run comes first
_MASS = "2 g"  # as `measure` takes it


@dataclass(frozen=True)
class TrackedSensor:
    """A sensor that stays: its name as `measure` has it, its place, and its mass."""

    name: str
    at_m: complex
    mass_kg: float

    @classmethod
    def parse(cls, text: str, device: Device) -> "TrackedSensor":
        """One of "board:35mm", or "NAME@35mm" of another sensor; "...,mass=0.1g" may follow. Raises SensorError."""
        name, _, rest = text.partition(":") if is_board(text) else text.rpartition("@")
        place, _, mass = rest.partition(",mass=")
        if not name or not place:
            raise SensorError(f"--track {text}: says no place; give board:35mm, or NAME@35mm of another sensor")
        try:
            return cls(name, read_point_on(place, device.surface.corner_m), read_quantity(mass or _MASS, "kg"))
        except QuantityError as error:
            raise SensorError(f"--track {text}: {error}") from None


class TrackProcess(BesideLoop):
    """The child, and the copy of the table that the run plays; a `Listener` of the loop for the board's accelerometer.

    Raises TableError for a table of measured responses, which nothing re-scales.
    """

    def __init__(self, table: Table, folder: Path, ring: Path, tracked: TrackedSensor) -> None:
        if "responses_sha256" in table.attributes:
            raise TableError(f"{table.path}: its responses were measured, and a model alone drifts: build it without")
        self.played, self.is_listening = folder / table.path.name, is_board(tracked.name)
        shutil.copyfile(table.path, self.played)
        self.identity = identity_of(self.played)
        arguments = {"played": str(self.played), "ring": str(ring), "tracked": tracked}
        super().__init__("tactable.track.track_process", arguments, _NAME)
        os.set_blocking(self._descriptor, False)
        self._has_ended = False

    def poll(self) -> Sequence[MeasuredFinger] | None:
        """The newest fingers that the child has told; none once it has ended; None: it has told nothing."""
        lines = self._read_lines()
        if lines is None:
            self._has_ended = True
            self._fall_silent("drift and fingers are no longer measured: the process has ended")
            return ()
        told = [decode_line(line, _NAME)["fingers"] for line in lines]
        return [MeasuredFinger(*each) for each in told[-1]] if told else None

    def begin_tracking(self, capabilities: Capabilities, scales: Sequence[float]) -> None:
        """Tell the child the board, and how the device's amplitudes are played on it."""
        self._child.write({"board": (capabilities, list(scales))})

    def begin_stream(self) -> None:
        """A stream of samples begins."""
        self._say(None)

    def take_event(self, event: Event) -> None:
        """Pass samples on; a frame that finds no room is lost, as one that the line lost is."""
        if isinstance(event, Acceleration | AccelerometerDescribed):
            self._say(event)

    def _say(self, event: Event | None) -> None:
        if self._has_ended:
            return
        with contextlib.suppress(BlockingIOError):
            self._child.write({"event": event, "heard_ns": SystemClock.now_ns()})


class Service:
    """Tracks for one run until the parent closes its end. Raises SensorError, TableError, DeviceError and RingError."""

    def __init__(self, parent: Parent, played: Path, ring: Path, tracked: TrackedSensor) -> None:
        self._parent, self._played, self._ring, self._tracked = parent, played, RingReader(ring), tracked
        with Table.open(played, verify=False) as table:
            self._device = table.device
        self._board: tuple[Capabilities, Sequence[float]] | None = None
        self._sensor: Sensor | None = None
        self._tracker: Tracker | None = None
        self._watched: list[Parent | SampleStream] = [parent]
        self._told, self._heard_ns = "", 0  # when the run passed the newest samples on; 0: the sensor is ours
        if not is_board(tracked.name):
            from tactable.measure.apparatus import open_sensor  # it needs scipy

            stream = open_sensor(tracked.name, self._device)
            self._watched.append(stream)
            self._take_sensor(stream)

    def run(self) -> None:
        """Follow the run until it ends."""
        while True:
            select.select(self._watched, (), (), _LOOK_S)
            while self._parent.has_spoken():
                if (line := self._parent.read()) is None:
                    return
                self._take_line(line)
            for record in self._ring.read():
                if self._tracker is not None:
                    lying = {touch.contact_id: touch.position_m for touch in record.touches}  # a palm is a load, too
                    self._tracker.take_touches(record.time_ns, lying)
            block = None if self._sensor is None else self._sensor.read()
            if self._tracker is not None and block is not None:
                own = replace(block, arrived_ns=self._heard_ns) if self._heard_ns else block
                if self._tracker.take_block(own):
                    self._act_on(self._tracker)
            if self._tracker is not None and (fingers := self._tracker.due_fingers()) is not None:
                self._parent.say({"fingers": fingers})

    def _take_sensor(self, sensor: Sensor) -> None:
        from tactable.track.tracker import Tracker

        self._sensor = sensor
        self._tracker = Tracker(self._device, sensor, self._tracked.at_m, self._tracked.mass_kg)

    def _take_line(self, line: dict[str, Any]) -> None:
        """What the run says: its board, that a stream begins, or something of the stream."""
        event, sensor = line.get("event"), self._sensor
        self._heard_ns = line.get("heard_ns", 0)
        if "board" in line:
            self._board = line["board"]
        elif isinstance(event, AccelerometerDescribed) and sensor is None and self._board is not None:
            self._take_sensor(BoardSensor(event, self._device, *self._board, SystemClock()))
        elif isinstance(sensor, BoardSensor):
            if event is None:
                sensor.begin_stream()
            else:
                sensor.take_event(event)

    def _act_on(self, tracker: "Tracker") -> None:
        """Say what is known, and build a table where one is due; nothing is heard meanwhile."""
        status, device = tracker.status(), tracker.due_device()
        if status["trouble"] and not self._told:
            write_note(f"tracking: the table is left as it is: {status['trouble']}")
        self._told = status["trouble"]
        if device is not None:
            tracker.note_rescaled(status["drift"], SystemClock.now_ns())
        write_text(self._played.with_name(STATUS), json.dumps(tracker.status()))
        if device is not None:  # all is said before the build, of which a run plays the first part at once
            write_note(f"tracking: the table is re-scaled for a drift of {100 * status['drift']:+.2f} %")
            try:
                _build(device, self._played)
            except TactableError as error:
                write_note(f"tracking: the table is left as it is: {error}")


def _build(device: Device, played: Path) -> None:
    """Build the table of a device in place of another one, with clicks as there: first those of one finger."""
    from precompute.builder.table_build import build_table
    from precompute.clicks.click_options import read_click_options

    with Table.open(played, verify=False) as table:
        options, most = read_click_options(table), int(table.attributes["clicks_up_to"])
    build_table(device, played, click_options=options, clicks_up_to=most, early=True)


def main(parent: Parent, arguments: Mapping[str, Any]) -> None:
    """The process behind a `TrackProcess`."""
    os.nice(_NICE)
    try:
        with threadpool_limits(1, "blas"):
            Service(parent, Path(arguments["played"]), Path(arguments["ring"]), arguments["tracked"]).run()
    except TactableError as error:  # the run goes on without it and reads no last words
        write_note(f"tracking has ended: {error}")
