"""The binary messages between the page's server and a browser: the only definition of the bytes, in both directions.

Little-endian binary frames of one WebSocket. Each begins with VERSION (u8) and its kind (u8). To the browser:

    SCENE   0x01  JSON: device, switches, state of the rig; whenever one of them changes
    PICTURE 0x02  the present state, up to 60 a second: u32 length of JSON, JSON of `Picture` but for its levels, then
                  i16 of 0.01 dB: its levels and counted levels (point,), and those of the paper's surface, if any
    MOTION  0x03  a moment of the moving surfaces, to be shown slowed: u8 points along, u8 rows of them, u8 fingers of
                  the command, u8 is_click, u16 steps, u32 command, f32 seconds per step, f32 m/s^2 at 32767, then i16
                  (surface, step, point and finger), ours first
    SOUND   0x04  what a finger felt: u32 finger, u32 samples per second, then i16 (sample,)

From the browser:

    TOUCHES 0x81  up to 64 times: u32 pointer, u8 phase (0 down, 1 move, 2 up, 3 cancel), f32 x, f32 y
    CHOICE  0x82  JSON of at most MOST_CHOICE_BYTES: the switches that change
    LISTEN  0x83  u32 finger, as a picture numbers it
    DEVICE  0x84  JSON of at most MOST_DEVICE_BYTES: "name" of a device file, and its "text"

Anything else is refused by a `PageMessageError`, whose `code` closes the WebSocket. Points of a field follow one
another along the surface, row by row.
"""

import json
import math
import struct
from dataclasses import dataclass, fields
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from base.arrays import Array
from base.plain import to_plain
from engine.touch.sources.pointer import Phase, PointerEvent

VERSION = 9  # raise it with any change of these bytes: an old page is told to load again
MOST_TOUCHES = 64  # the events of ten fingers in six pictures
MOST_CHOICE_BYTES = 2048  # bounds what a hostile page can have parsed
MOST_DEVICE_BYTES = 65_536  # shipped device files have 2 to 3 kB
MOST_BYTES = 2 + MOST_DEVICE_BYTES
"""Limit of a message from a browser; a longer one closes the WebSocket before it is read."""
LOWEST_DB = -60.0  # the lowest level that is sent

_HEAD = struct.Struct("<BB")
_TOUCH = struct.Struct("<IBff")
_FINGER_NUMBER = struct.Struct("<I")
_SIZE = struct.Struct("<I")
_MOTION = struct.Struct("<BBBBHIff")
_SOUND = struct.Struct("<II")
_PER_DB = 100  # i16 in centibel: finer than anything that is shown
_WORD = 32_767  # the greatest int16
_PHASES = (Phase.DOWN, Phase.MOVE, Phase.UP, Phase.CANCEL)


class Kind(IntEnum):
    """Second byte of every message."""

    SCENE = 0x01
    PICTURE = 0x02
    MOTION = 0x03
    SOUND = 0x04
    TOUCHES = 0x81
    CHOICE = 0x82
    LISTEN = 0x83
    DEVICE = 0x84


class CloseCode(IntEnum):
    """Why the server closes a WebSocket."""

    NOT_BINARY = 1003
    MALFORMED = 1007
    TOO_BIG = 1009
    CROWDED = 1013
    OTHER_VERSION = 4001


class PageMessageError(ValueError):
    """A browser sent an invalid message; `code` closes the WebSocket."""

    def __init__(self, code: CloseCode, text: str) -> None:
        super().__init__(text)
        self.code = code


class Role(IntEnum):
    """Role of a finger in a command."""

    NONE = 0  # the finger came after the command, or lies where no finger was when it was made
    QUIET = 1
    FELT = 2


class Drive(IntEnum):
    """Kind of the last command."""

    SILENCE = 0
    STEADY = 1
    CLICK = 2


@dataclass(frozen=True, slots=True)
class FingerPicture:
    """A finger: `level_db` is its present level, `felt_db` the greatest since the last command."""

    number: int
    zone: int | None
    role: Role  # its role in the last command
    position_m: complex
    level_db: float
    felt_db: float


@dataclass(frozen=True, slots=True)
class MadePicture:
    """A finger that the last command was made for, its promised and its simulated level; None: not known.

    number: of the finger that touches there, None once that has left. low_db, high_db: what sampled bars and fingers
    give, 5th and 95th percentile.
    """

    number: int | None
    zone: int | None
    role: Role
    position_m: complex
    promised_db: float | None
    simulated_db: float | None
    low_db: float | None = None
    high_db: float | None = None


@dataclass(frozen=True, slots=True)
class ChannelPicture:
    """The last command to an actuator."""

    frequency_hz: float
    amplitude: float
    phase_rad: float


@dataclass(frozen=True, slots=True)
class PaperPicture:
    """The second surface, which the paper's drives move.

    fingers_db (finger,): the present level, and the greatest since the last command; simulated_db (made finger,).
    levels_db, counted_db (point,): as those of the picture.
    """

    fingers_db: tuple[tuple[float, float], ...]
    simulated_db: tuple[float | None, ...]
    levels_db: Array
    counted_db: Array


@dataclass(frozen=True, slots=True)
class Picture:
    """The present state."""

    time_s: float
    counters: tuple[int, int, int, int, int, int]  # the fields of engine.loop.ring.RingCounters
    command: int  # number of the last command; 0 before the first
    age_s: float  # age of the last command
    wanted_db: float  # level of the last command; infinite: full scale
    last_ns: tuple[int, int, int, int, int]
    """Latency of the last command that a report caused, from each stage (observer.Stage) to the next."""
    median_ns: tuple[int, int, int, int, int]  # median of the same over the last `latencies` commands
    latencies: int
    drive: Drive
    is_loaded: bool  # the fingers are in the plant
    is_playing: bool  # the command still drives
    is_late: bool
    """The machine stalled during the command, or the firmware never had it in time: what it did is not judged."""
    fingers: tuple[FingerPicture, ...]
    made: tuple[MadePicture, ...]  # the fingers that the last command was made for
    channels: tuple[ChannelPicture, ...]
    levels_db: Array
    """Shape (point,), evenly from edge to edge, row by row: the present level there, dB above threshold."""
    counted_db: Array
    """The same of the last command: the greatest since a click began, the mean power of a steady drive.

    The page draws its curve or map from it. A browser that missed pictures would miss the peak of a click otherwise.
    """
    rows: int = 1  # rows of levels across the surface
    paper: PaperPicture | None = None  # the second surface, where there is one
    is_mixed: bool = False
    """A quiet finger still felt a click of its own when this one began: their levels are no comparison."""


def encode_scene(scene: dict[str, Any]) -> bytes:
    """Encode a SCENE. Raises ValueError for values that JSON does not have."""
    return _HEAD.pack(VERSION, Kind.SCENE) + json.dumps(scene, allow_nan=False).encode()


def encode_picture(picture: Picture) -> bytes:
    """Encode a PICTURE."""
    paper = picture.paper
    levels_db = [picture.levels_db, picture.counted_db]
    told = _told(picture) | {"paper": None if paper is None else _told(paper)}
    levels_db += [] if paper is None else [paper.levels_db, paper.counted_db]
    text = json.dumps(told, allow_nan=False).encode()
    words = np.rint(_PER_DB * np.clip(np.concatenate(levels_db), LOWEST_DB, -LOWEST_DB)).astype("<i2")
    return _HEAD.pack(VERSION, Kind.PICTURE) + _SIZE.pack(len(text)) + text + words.tobytes()


def _told(part: Picture | PaperPicture) -> dict[str, Any]:
    """The fields that travel as JSON."""
    names = [field.name for field in fields(part) if field.name not in ("levels_db", "counted_db", "paper")]
    return {name: to_plain(getattr(part, name)) for name in names}


def encode_motion(acceleration: Array, size: tuple[int, int], step_s: float, command: int, *, is_click: bool) -> bytes:
    """Encode a MOTION of accelerations (surface, step, point and finger) in m/s^2, on a field of `size` along, rows."""
    _, steps, columns = acceleration.shape
    fingers = columns - size[0] * size[1]
    scale = max(float(abs(acceleration).max(initial=0.0)), 1e-9)
    words = np.rint(acceleration * (_WORD / scale)).astype("<i2").tobytes()
    return (
        _HEAD.pack(VERSION, Kind.MOTION) + _MOTION.pack(*size, fingers, is_click, steps, command, step_s, scale) + words
    )


def encode_sound(finger: int, rate_hz: int, samples: NDArray[np.int16]) -> bytes:
    """Encode a SOUND of samples (time,)."""
    return _HEAD.pack(VERSION, Kind.SOUND) + _SOUND.pack(finger, rate_hz) + samples.astype("<i2").tobytes()


@dataclass(frozen=True, slots=True)
class DroppedFile:
    """A device file that was dropped on the page; nothing is checked yet but that it is text."""

    name: str
    text: str


Asked = tuple[PointerEvent, ...] | dict[str, Any] | int | DroppedFile
"""A request of a browser: touches, switches, the number of the finger to hear, or a device file."""


def decode_message(data: bytes) -> Asked:
    """Decode a message of a browser. Raises PageMessageError for an invalid one or another version."""
    if len(data) > MOST_BYTES:
        raise PageMessageError(CloseCode.TOO_BIG, f"a message of {len(data)} bytes; expected at most {MOST_BYTES}")
    if len(data) < _HEAD.size:
        raise PageMessageError(CloseCode.MALFORMED, f"a message of {len(data)} bytes has no head")
    version, kind = _HEAD.unpack_from(data)
    if version != VERSION:
        raise PageMessageError(CloseCode.OTHER_VERSION, f"version {version}; expected {VERSION}: load the page again")
    body = data[_HEAD.size :]
    if kind == Kind.TOUCHES:
        return _decode_touches(body)
    if kind == Kind.CHOICE:
        return _decode_choice(body)
    if kind == Kind.LISTEN and len(body) == _FINGER_NUMBER.size:
        number: int = _FINGER_NUMBER.unpack(body)[0]
        return number
    if kind == Kind.DEVICE:
        return _decode_device(body)
    raise PageMessageError(CloseCode.MALFORMED, f"{len(body)} bytes of kind 0x{kind:02x}: not a message of a browser")


def _decode_touches(body: bytes) -> tuple[PointerEvent, ...]:
    count, rest = divmod(len(body), _TOUCH.size)
    if rest or not 1 <= count <= MOST_TOUCHES:
        raise PageMessageError(CloseCode.MALFORMED, f"{len(body)} bytes are no 1 to {MOST_TOUCHES} touches")
    return tuple(_decode_touch(*values) for values in _TOUCH.iter_unpack(body))


def _decode_touch(pointer_id: int, phase: int, x: float, y: float) -> PointerEvent:
    if phase >= len(_PHASES) or not (math.isfinite(x) and math.isfinite(y)):
        raise PageMessageError(CloseCode.MALFORMED, f"pointer {pointer_id}: phase {phase} at ({x}, {y})")
    return PointerEvent(pointer_id, x, y, _PHASES[phase])


def _decode_choice(body: bytes) -> dict[str, Any]:
    if len(body) > MOST_CHOICE_BYTES:
        raise PageMessageError(
            CloseCode.TOO_BIG, f"{len(body)} bytes of switches; expected at most {MOST_CHOICE_BYTES}"
        )
    return _decode_object(body, "switches")


def _decode_device(body: bytes) -> DroppedFile:
    found = _decode_object(body, "a device file")
    name, text = found.get("name"), found.get("text")
    if not isinstance(name, str) or not isinstance(text, str) or set(found) != {"name", "text"}:
        raise PageMessageError(CloseCode.MALFORMED, "a device file: expected its name and its text")
    return DroppedFile(name, text)


def _decode_object(body: bytes, what: str) -> dict[str, Any]:
    try:
        found = json.loads(body)
    except (ValueError, RecursionError) as error:
        raise PageMessageError(CloseCode.MALFORMED, f"{what}: is not JSON: {error}") from error
    if not isinstance(found, dict):
        raise PageMessageError(CloseCode.MALFORMED, f"{what}: is {type(found).__name__}; expected an object")
    return found
