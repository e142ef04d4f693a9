"""Every command that a run may send, as the compiled step looks it up: encoded bodies, and their numbers by state."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.loop.fast.layout import CONSTANTS
from engine.loop.fast.layout import Command as CommandPlace
from engine.render import SILENCE, Command, DriveCommand, Rendering
from firmware_link.host.link_values import Capabilities
from firmware_link.protocol.messages import DRIVE_SIZE, encode_play_body, encode_set_body

MOST_CELLS = 1 << 22
"""Numbers by level, kind and state: 16 MiB. Beyond, the Python loop sends all commands."""


@dataclass(frozen=True)
class FastTable:
    """The commands of one renderer for one connected device."""

    levels_db: tuple[float, ...]
    """Rising."""
    numbers: dict[Command, int]
    """0 is silence."""
    commands: NDArray[np.void]
    """Shape (command,), each a `Command` of the layout; sequence and clock reference are filled in when it is sent."""
    command_of: NDArray[np.int32]
    """Shape (level, steady or click, state): a number; that of silence where nothing is known."""
    lease_ms: int
    drive_size: int
    """Bytes, of the drive of every actuator of the device."""


@dataclass(frozen=True)
class FastRendering(Rendering):
    """A rendered table with the commands as the compiled step reads them."""

    fast_table: FastTable | None
    """None where the commands are too many or too long."""


def with_fast_table(rendering: Rendering, capabilities: Capabilities) -> FastRendering:
    """The rendering with its fast table; it takes long enough to be made before the loop needs it."""
    configuration, zones = rendering.configuration, len(rendering.device.zones)
    lease_ms = min(configuration.lease_ms, capabilities.longest_lease_ms)
    drive_size = DRIVE_SIZE * capabilities.number_of_actuators
    fast_table = _make_fast_table(rendering, 3**zones, lease_ms, drive_size)
    return FastRendering(
        rendering.device,
        rendering.renderer,
        configuration,
        rendering.click_length_ns,
        fast_table,
    )


def _make_fast_table(rendering: Rendering, states: int, lease_ms: int, drive_size: int) -> FastTable | None:
    renderer = rendering.renderer
    levels_db = tuple(sorted(renderer.levels_db))
    shape = (len(levels_db), 2, states)
    if np.prod(shape, dtype=float) > MOST_CELLS:
        return None
    command_of = np.zeros(shape, np.int32)
    numbers: dict[Command, int] = {SILENCE: 0}
    for level_db, is_click, state, command in renderer.commands():
        number = numbers.setdefault(command, len(numbers))
        command_of[levels_db.index(level_db), int(is_click), state] = number
    bodies = [_body_of(command, lease_ms, drive_size) for command in numbers]
    if max(map(len, bodies)) > CONSTANTS["LONGEST_BODY"]:
        return None
    commands = np.zeros(len(bodies), np.dtype(CommandPlace))
    for row, command, body in zip(commands, numbers, bodies, strict=True):
        row["kind"] = CONSTANTS["SET" if isinstance(command, DriveCommand) else "PLAY"]
        row["size"] = len(body)
        row["body"][: len(body)] = np.frombuffer(body, np.uint8)
    return FastTable(levels_db, numbers, commands, command_of, lease_ms, drive_size)


def _body_of(command: Command, lease_ms: int, drive_size: int) -> bytes:
    if isinstance(command, DriveCommand):
        return encode_set_body(0, lease_ms, command.drive.ljust(drive_size, b"\0"), 0)
    return encode_play_body(0, command.click.play, 0)
