"""What a table has to be looked up, as the compiled step reads it: arrays that it composes a PLAY from, and SETs.

All levels share the weights, and a level is a column of amplitudes. So the arrays of thirteen thousand clicks at three
levels take 1.5 MB, most of which the renderer holds anyway.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from engine.loop.fast.fast_layout import CONSTANTS
from engine.render.prepared import Rendering
from engine.render.renderer import SILENCE, DriveCommand
from engine.render.steady_drives import ZoneDrives
from engine.touch.placement import Places
from firmware_link.host.link_values import Capabilities
from firmware_link.protocol.drive_words import DRIVE_SIZE
from firmware_link.protocol.messages import encode_set_body

MOST_CELLS = 1 << 22  # rows by two fingers, or amplitudes by level and row: 16 MiB; beyond, the Python loop answers
_MOST_WEIGHTS = (CONSTANTS["LONGEST_BODY"] - CONSTANTS["PLAY_HEAD"]) // 2


@dataclass(frozen=True, eq=False)
class FastTable:
    """The clicks of one renderer for one connected device, and its drives where they are those of zones."""

    levels_db: tuple[float, ...]  # rising
    places: Places
    pair: NDArray[np.int32]  # rows by the codes of two fingers, as `engine.table.clicks.Clicks.pair`
    head: NDArray[np.uint8]  # (click, 3): number of the click's set, its fraction bits, its number of weights
    weights: NDArray[np.int16]  # shape (row, function)
    amplitude: NDArray[np.int32]  # words (level, row); NONE for a click that is not played
    plays_clicks: bool  # whether clicks are played by clicks; otherwise the drive of the zones takes their place
    drives: NDArray[np.uint8] | None  # bodies (level, combination, byte) of the SETs of zones; None: drives are solved
    silence: bytes  # body of the SET of silence; sequence and clock reference are filled in when it is sent
    lease_ms: int
    drive_size: int  # bytes, of the drive of every actuator of the device


@dataclass(frozen=True)
class FastRendering(Rendering):
    """A rendered table with its clicks as the compiled step reads them."""

    fast_table: FastTable | None  # for the compiled step; None where clicks are too many, or none is played


def with_fast_table(rendering: Rendering, capabilities: Capabilities) -> FastRendering:
    """The rendering with its fast table; it takes long enough to be made before the loop needs it."""
    return FastRendering(**vars(rendering) | {"fast_table": _make_fast_table(rendering, capabilities)})


def _make_fast_table(rendering: Rendering, capabilities: Capabilities) -> FastTable | None:
    rendered, levels_db = rendering.renderer.clicks, tuple(sorted(rendering.renderer.levels_db))
    clicks = rendered.clicks
    cells = max((2 * clicks.places.count + 1) ** 2, len(levels_db) * len(clicks))
    if cells > MOST_CELLS or len(rendering.device.zones) > CONSTANTS["MOST_ZONES"]:
        return None
    lease_ms = min(rendering.configuration.lease_ms, capabilities.longest_lease_ms)
    drive_size = DRIVE_SIZE * capabilities.number_of_actuators
    silence = encode_set_body(0, lease_ms, bytes(drive_size), 0)
    if len(silence) > CONSTANTS["LONGEST_BODY"]:
        return None
    # Number in the device, and functions, of each set of the table's basis; 0 for a set that the device has not.
    sets = np.zeros((0 if clicks.basis is None else len(clicks.basis.sets), 2), np.uint8)
    for number, held in rendered.basis.sets.items():
        assert clicks.basis is not None  # it has the set
        sets[number] = held, len(clicks.basis.sets[number].actuators)
    fraction_bits = np.maximum(0, clicks.fraction_bits - rendered.basis.halvings)  # 0 is never played
    head = np.column_stack([sets[clicks.basis_set, 0], fraction_bits, sets[clicks.basis_set, 1]])
    amplitude = np.empty((len(levels_db), len(clicks)), np.int32)
    for words, level_db in zip(amplitude, levels_db, strict=True):
        words[:] = np.where(head[:, 2] > _MOST_WEIGHTS, CONSTANTS["NONE"], rendered.amplitude_words(level_db))
    return FastTable(
        levels_db,
        clicks.places,
        np.ascontiguousarray(clicks.pair, np.int32),
        np.ascontiguousarray(head, np.uint8),
        np.ascontiguousarray(clicks.weights, np.int16),
        amplitude,
        rendered.are_played,
        _drives_of_zones(rendering, levels_db, silence, lease_ms),
        silence,
        lease_ms,
        drive_size,
    )


def _drives_of_zones(
    rendering: Rendering, levels_db: Sequence[float], silence: bytes, lease_ms: int
) -> NDArray[np.uint8] | None:
    steady = rendering.renderer.steady
    if not isinstance(steady, ZoneDrives):
        return None
    bodies = np.empty((len(levels_db), 1 << len(rendering.device.zones), len(silence)), np.uint8)
    bodies[:] = np.frombuffer(silence, np.uint8)
    for place, level_db in enumerate(levels_db):
        for combination in steady.rows:
            command = steady.of_zones(combination, level_db).command
            if command != SILENCE:
                assert isinstance(command, DriveCommand)
                bodies[place, combination] = np.frombuffer(encode_set_body(0, lease_ms, command.drive, 0), np.uint8)
    return bodies
