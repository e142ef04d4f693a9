"""The memory that the compiled step and Python share, declared once: to a C header and to ctypes structures.

Every number is 64 bits wide, so both languages lay the structures out alike without padding between fields. What a
table has to be looked up lies in arrays beside them (`FastTable`).
"""

import ctypes
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from engine.effects.effect_play import SPEED_NS
from engine.render.prepared import Rendering
from engine.render.renderer import SILENCE, DriveCommand, ZoneDrives
from engine.touch.digitizer import FRAME_SILENCE_NS
from engine.touch.placement import MOST_FINGERS, Places
from firmware_link.host.link_values import Capabilities
from firmware_link.protocol.drive_words import DRIVE_SIZE
from firmware_link.protocol.messages import Play, encode_play, encode_play_body, encode_set_body

CONSTANTS = {
    "MOST_PLANS": 8,
    "MOST_SLOTS": 40,
    "MOST_CONTACTS": 64,
    "MOST_FINGERS": 2,  # of a click that is looked up
    "MOST_PLACED": MOST_FINGERS,  # of a drive that is looked up
    "MOST_ZONES": 16,
    "SIDES": 2,  # of a plate; a bar has the first one
    "MOST_RULES": 64,
    "MOST_WAITED": 6,  # the touches, the port, new tables, solved clicks, control steps, measured fingers
    "LONGEST_BODY": 250,  # of a command; up to here COBS has one block without a zero
    "PACKET_SIZE": 4096,
    "ROOM_BEHIND": 16,  # a field is read as eight bytes from the one that it begins in
    "FRAME_SIZE": 256,
    "NONE": -1,  # stands for None
    "SET": 1,
    "PLAY": 2,  # kinds of commands
    "PLAY_TYPE": Play.type_byte,
    "PLAY_HEAD": len(encode_play_body(0, encode_play(0, 1, 0, ()), 0)),  # bytes before the weights
    "KEY_ID": 0,
    "KEY_SLOT": 1,
    "KEY_SLOT_FROM_ONE": 2,
    "KEY_NUMBER": 3,  # `engine.touch.quirks.Key`
    "TOUCH": 0,
    "LIFT": 1,  # triggers of rules
    "FRAME_SILENCE_NS": FRAME_SILENCE_NS,
    "SPEED_NS": SPEED_NS,
}
NONE = CONSTANTS["NONE"]

STRUCTURES = {
    # A field of a report: `byte` and `shift` of its lowest bit. A mask of 0: the device has no such field.
    "Bits": ["int64_t byte shift mask"],
    # A coordinate of a contact along a side of the surface, in logical units.
    "Place": ["Bits bits", "int64_t sign minimum maximum"],
    "Slot": ["Bits tip contact_id valid hover confidence", "Place place[SIDES]"],
    "Plan": ["int64_t report_id needed_bytes slots", "Bits count scan_time", "Slot slot[MOST_SLOTS]"],
    # A point of the surface, metres; on a bar the second coordinate is 0.
    "Point": ["double m[SIDES]"],
    # Where the rule holds: between start and stop; where has_region is 0, in the zones whose bits are set in `zones`
    # (NONE: in all zones).
    "Rule": ["int64_t trigger zones level is_click has_region", "Point start stop"],
    "Command": ["int64_t kind size", "uint8_t body[LONGEST_BODY]"],
    "Active": ["int64_t contact_id place[SIDES] tip seen"],
    # `held` is the position that drives are made for; `early` and `late` are where it was, for its speed.
    "Finger": ["int64_t contact_id zone level click_ns early_ns late_ns", "Point position held early late"],
    # A side of the surface: how the digitizer lies along it (`zero` is the logical place of its start), and the places
    # of clicks along it. Where there is no second side, all of it is 0, but for one place and a pitch.
    "Side": ["int64_t zero places", "double start_m m_per_unit length_m pitch_m"],
    "Fast": [
        # What stays during a run: the digitizer,
        "int64_t uses_report_ids packet_head plans key count_is_accurate frame_may_be_empty ignores_duplicates",
        "int64_t unseen_means_up maximum_contacts",
        "Plan plan[MOST_PLANS]",
        # the surface, the rules,
        "Side side[SIDES]",
        "Point zone_start[MOST_ZONES] zone_stop[MOST_ZONES]",
        "double follow_m furthest_m closest_m reach_m",
        "int64_t zones rules follows_moves ahead_ns",
        "Rule rule[MOST_RULES]",
        # the clicks: a row, NONE without a click, by the codes of two fingers (0 for no finger, else 1 + 2 * place +
        # is_felt); of each row its set, fraction bits and number of weights, and the weights; amplitudes by level and
        # row, NONE for a click that is not played;
        "int64_t places rows functions",
        "const_int32_t* pair",
        "const_uint8_t* head",
        "const_int16_t* weight",
        "const_int32_t* amplitude",
        # the drives of zones by level and combination, each the body of a SET (0: drives are solved, by the loop),
        "const_uint8_t* drive",
        "int64_t plays_clicks",
        # the command of silence, and seeds of the checksum by kind.
        "Command silence",
        "int64_t seed[3]",
        "int64_t timer armed_ns",
        # The moment before the wait: what is waited for,
        "int64_t can_answer touch link waited descriptor[MOST_WAITED]",
        # how far the frame is (`axis_ns` is the source's time axis less the clock),
        "int64_t axis_ns received expected ticks taken report_ns due_ns",
        # what is wanted, the drive that the device holds, and what the link would send a command with,
        "int64_t level click_ns",
        "Command held",
        "int64_t line_free_ns set_from_ns play_from_ns sequence clock_at_ns",
        "double clock_middle_ns clock_drift",
        # the contacts in range, and the fingers: those that touch, then those lifted whose effect goes on.
        "int64_t actives fingers lifted",
        "Active active[MOST_CONTACTS]",
        "Finger finger[2*MOST_CONTACTS]",
        # What came of the wait.
        "int64_t readable[MOST_WAITED] packet_size frame_size written",
        "int64_t read_ns frame_ns state_ns asked_ns command_ns written_ns",
        "uint8_t packet[PACKET_SIZE+ROOM_BEHIND] frame[FRAME_SIZE]",
    ],
}

_PLACE = re.compile(r"(\w+)(?:\[([\w+*]+)\])?")


def _fields(lines: list[str]) -> list[tuple[str, str, str]]:
    """Type, name and number of places ("" for a single one) of each field."""
    found = []
    for kind, *names in map(str.split, lines):
        for name in names:
            place = _PLACE.fullmatch(name)
            assert place is not None, name
            found.append((kind.replace("_", " ", 1) if kind.startswith("const") else kind, place[1], place[2] or ""))
    return found


def c_header() -> str:
    """The header that engine/loop/fast/step.c includes."""
    lines = ["/* Made from engine/loop/fast/fast_layout.py. */", "#include <stdint.h>", "", "enum {"]
    lines += [f"    {name} = {value}," for name, value in CONSTANTS.items()]
    lines.append("};")
    for structure, fields in STRUCTURES.items():
        places = (f"    {kind} {name}{f'[{count}]' * bool(count)};" for kind, name, count in _fields(fields))
        lines += ["", "typedef struct {", *places, f"}} {structure};"]
    return "\n".join(lines) + "\n"


def _structures() -> dict[str, Any]:
    kinds: dict[str, Any] = {"int64_t": ctypes.c_int64, "double": ctypes.c_double, "uint8_t": ctypes.c_uint8}
    for structure, fields in STRUCTURES.items():
        members = []
        for kind, name, count in _fields(fields):
            member = ctypes.c_void_p if kind.endswith("*") else kinds[kind]
            members.append((name, member * eval(count, {}, CONSTANTS) if count else member))
        kinds[structure] = type(structure, (ctypes.Structure,), {"_fields_": members})
    return kinds


_MADE = _structures()
Fast = _MADE["Fast"]
MOST_CELLS = 1 << 22  # rows by two fingers, or amplitudes by level and row: 16 MiB; beyond, the Python loop answers
_MOST_WEIGHTS = (CONSTANTS["LONGEST_BODY"] - CONSTANTS["PLAY_HEAD"]) // 2


@dataclass(frozen=True, eq=False)
class FastTable:
    """The clicks of one renderer for one connected device, and its drives where they are those of zones.

    The step composes a PLAY from these arrays. All levels share the weights, and a level is a column of amplitudes. So
    the arrays of thirteen thousand clicks at three levels take 1.5 MB, most of which the renderer holds anyway.
    """

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
