"""Every command that a run may send, as the fast path looks it up: bodies in a row, and numbers by level and state."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.render.renderer import SILENCE, Command, DriveCommand, Renderer
from firmware_link.host.link_values import Capabilities
from firmware_link.protocol.messages import DRIVE_SIZE, encode_amplitude, encode_play_body, encode_set_body

LONGEST_BODY = 240
"""A longer body takes the long way: one of 28 actuators or more. Up to here COBS has one block without a zero."""
MOST_CELLS = 1 << 22
"""Numbers by level, kind and state: 16 MiB. Beyond, all commands take the long way."""
COMMAND = np.dtype([("kind", np.int64), ("size", np.int64), ("body", np.uint8, LONGEST_BODY)])
"""One command as engine/loop/fast/step.c has it; its sequence and clock reference are filled in when it is sent."""
_KIND_SET, _KIND_PLAY = 1, 2


@dataclass(frozen=True)
class FastTable:
    """The commands of one renderer for one connected device."""

    levels_db: tuple[float, ...]
    """Rising."""
    numbers: dict[Command, int]
    """0 is silence."""
    commands: NDArray[np.void]
    """Shape (command,), of COMMAND."""
    command_of: NDArray[np.int32]
    """Shape (level, steady or click, state): a number; that of silence where nothing is known."""
    lease_ms: int
    drive_size: int
    """Bytes, of the drive of every actuator of the device."""


def make_fast_table(
    renderer: Renderer, capabilities: Capabilities, number_of_zones: int, lease_ms: int
) -> FastTable | None:
    """All that `renderer` may return, encoded; None where that is too much."""
    lease_ms = min(lease_ms, capabilities.longest_lease_ms)
    drive_size = DRIVE_SIZE * capabilities.number_of_actuators
    levels_db = tuple(sorted(renderer.levels_db))
    shape = (len(levels_db), 2, 3**number_of_zones)
    if np.prod(shape, dtype=float) > MOST_CELLS:
        return None
    command_of = np.zeros(shape, np.int32)
    numbers: dict[Command, int] = {SILENCE: 0}
    for level_db, is_click, state, command in renderer.commands():
        number = numbers.setdefault(command, len(numbers))
        command_of[levels_db.index(level_db), int(is_click), state] = number
    bodies = [_body_of(command, lease_ms, drive_size) for command in numbers]
    if max(map(len, bodies)) > LONGEST_BODY:
        return None
    commands = np.zeros(len(bodies), COMMAND)
    for row, command, body in zip(commands, numbers, bodies, strict=True):
        row["kind"] = _KIND_SET if isinstance(command, DriveCommand) else _KIND_PLAY
        row["size"] = len(body)
        row["body"][: len(body)] = np.frombuffer(body, np.uint8)
    return FastTable(levels_db, numbers, commands, command_of, lease_ms, drive_size)


def _body_of(command: Command, lease_ms: int, drive_size: int) -> bytes:
    if isinstance(command, DriveCommand):
        return encode_set_body(0, lease_ms, command.drive.ljust(drive_size, b"\0"), 0)
    return encode_play_body(0, command.waveform, encode_amplitude(command.amplitude), 0)
