"""Sensors behind one small interface: blocks of samples with a declared rate, channels and units.

A converter has its own clock, and between a sample and its arrival lies a latency that differs from one start to the
next. Both are unknown. So a sensor that can, records the drive of an actuator beside the acceleration, by a *loopback*
channel: both pass through the same converter, and their ratio has neither clock nor latency in it. Without loopback
the magnitude of a response is known and its phase is not.

Any converter that a program can read is a sensor through a file or a pipe of samples. The stream begins with one line
of JSON that declares the form; what follows are samples as little-endian float32, all channels of an instant beside
each other (tables/MEASUREMENTS.md, *Samples*):

    {"tactable_samples": 1, "sample_rate": "8 kHz", "channels": [{"name": "acceleration", "scale": "98.1 m/s^2",
     "clips_at": 1.0}, {"name": "loopback left", "scale": "100 %"}]}

`scale` says what a sample of 1 stands for, so that a converter may write volts; `clips_at` is its greatest value.
"""

import contextlib
import json
import math
import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from base.arrays import Array
from base.errors import TactableError
from engine.device import Device
from engine.device.toml_table import TomlTable

ACCELERATION = "acceleration"
LOOPBACK = "loopback "
FORCE, REFERENCE = "force", "reference"
UNITS = {ACCELERATION: "m/s^2", FORCE: "N", REFERENCE: "m/s^2"}
"""Units by channel; a loopback has none."""
_VERSION = 1
_MOST = 1e30
_PATIENCE_NS = 10_000_000_000  # for the whole header
_READ_SIZE = 1 << 16
_LONGEST_HEADER = 1 << 16


class SensorError(TactableError, ValueError):
    """A sensor or a stream of samples cannot be used; the message names it, the place and the remedy."""


@dataclass(frozen=True)
class SensorForm:
    """Form of the samples of a sensor: rate, channels and their ends.

    channels: "acceleration" in m/s^2, and "loopback NAME" in fractions of full scale for an actuator NAME whose drive
    is recorded; of taps "force" in N, and "reference" in m/s^2, of an accelerometer that stays in place. clips_at
    (channel,): the greatest value that each can have, infinite where that is not known.
    """

    sample_rate_hz: float
    channels: tuple[str, ...]
    clips_at: tuple[float, ...]
    is_simulated: bool = False

    @property
    def acceleration(self) -> int:
        """Index of the channel of the acceleration."""
        return self.channels.index(ACCELERATION)

    def loopback(self, actuator: str) -> int | None:
        """Index of the channel that records the drive of an actuator; None where none does."""
        name = LOOPBACK + actuator
        return self.channels.index(name) if name in self.channels else None


@dataclass(frozen=True)
class Block:
    """Samples (sample, channel) in the units of the form, in the order in which they were taken.

    NaN is a sample that the source knows to be lost. arrived_ns: host time after they were read.
    """

    values: Array
    arrived_ns: int


class Sensor(Protocol):
    """A running converter. `close` ends it."""

    @property
    def form(self) -> SensorForm:
        """Form of the samples."""

    def fileno(self) -> int:
        """The descriptor, to poll."""

    def read(self) -> Block | None:
        """New samples since the last call, or None. Raises SensorError at the end of the stream."""

    def pace(self) -> float:
        """The pace of its clock over the board's, less 1, where it knows it already; 0 where not."""

    def close(self) -> None:
        """End it."""


class SampleStream:
    """Samples of a file, a named pipe or another descriptor; raises SensorError for a stream of another form."""

    def __init__(self, path: Path, device: Device) -> None:
        self._path = path
        try:
            self._descriptor = os.open(path, os.O_RDONLY)
        except OSError as error:
            raise SensorError(f"{path}: cannot be opened ({error.strerror}); name a file or pipe of samples") from None
        try:
            line, self._rest = self._read_header()
            self.form, self._scale = read_header(line, device, str(path))
        except SensorError:
            self.close()
            raise
        os.set_blocking(self._descriptor, False)

    def fileno(self) -> int:
        """The descriptor, to poll."""
        return self._descriptor

    def read(self) -> Block | None:
        """New samples, or None. Raises SensorError at the end of the stream."""
        data, is_ended = self._rest, False
        self._rest = b""
        with contextlib.suppress(BlockingIOError):
            while part := os.read(self._descriptor, _READ_SIZE):
                data += part
            is_ended = True
        size = 4 * len(self._scale)
        whole = len(data) // size * size
        self._rest = data[whole:]
        if not whole:
            if is_ended:
                raise SensorError(f"{self._path}: the samples have ended; keep the converter running meanwhile")
            return None
        raw = np.frombuffer(data[:whole], "<f4").reshape(-1, len(self._scale))
        return Block(raw * self._scale, time.monotonic_ns())

    def pace(self) -> float:
        """Nothing is known of the converter's clock before a tone is read."""
        return 0.0

    def close(self) -> None:
        """Close the descriptor."""
        os.close(self._descriptor)

    def _read_header(self) -> tuple[bytes, bytes]:
        """The first line, and what came behind it."""
        data, end_ns = b"", time.monotonic_ns() + _PATIENCE_NS
        while b"\n" not in data:
            part = os.read(self._descriptor, _READ_SIZE)
            data += part
            if not part or len(data) > _LONGEST_HEADER or time.monotonic_ns() > end_ns:
                raise SensorError(f"{self._path}: does not begin with a line of JSON that declares the samples")
        line, _, rest = data.partition(b"\n")
        return line, rest


def write_header(form: SensorForm) -> bytes:
    """The line that declares samples in the units of the form."""
    channels: list[dict[str, Any]] = []
    for name, clips_at in zip(form.channels, form.clips_at, strict=True):
        channel: dict[str, Any] = {"name": name, "scale": f"1 {UNITS[name]}" if name in UNITS else "100 %"}
        channels.append(channel | ({"clips_at": clips_at} if math.isfinite(clips_at) else {}))
    header = {
        "tactable_samples": _VERSION,
        "sample_rate": f"{form.sample_rate_hz!r} Hz",
        "channels": channels,
        "simulated": form.is_simulated,
    }
    return json.dumps(header).encode() + b"\n"


class _Declaration(TomlTable):
    """A part of a header; what is wrong with it is a SensorError."""

    family = SensorError


def read_header(line: bytes, device: Device, source: str) -> tuple[SensorForm, Array]:
    """The form that a header declares, and the scale (channel,) of its samples. Raises SensorError."""
    try:
        values = json.loads(line)
    except (ValueError, RecursionError):
        values = None
    version = values.pop("tactable_samples", None) if isinstance(values, dict) else None
    if type(version) is not int or version != _VERSION:
        raise SensorError(f'{source}: does not begin with {{"tactable_samples": {_VERSION}, ...}}; declare the samples')
    header = _Declaration(source, "", values)
    rate_hz = header.quantity("sample_rate", "Hz", exclusive=True)
    channels, is_simulated = header.take_value("channels"), header.flag("simulated", False)
    header.refuse_rest()
    if not isinstance(channels, list) or not channels:
        raise header.error("channels", channels, "expected a list of objects, each with name and scale")
    names, scales, clips_at = [], [], []
    known = (*UNITS, *(LOOPBACK + actuator.name for actuator in device.actuators))
    for number, each in enumerate(channels):
        channel = _Declaration(source, f"channels[{number}]", each)
        name = channel.word("name", tuple(each for each in known if each not in names))
        scale = channel.quantity("scale", UNITS.get(name, ""), exclusive=True)
        greatest = channel.take_value("clips_at", math.inf)
        channel.refuse_rest()
        if type(greatest) not in (int, float) or not (0 < greatest <= _MOST or greatest == math.inf):
            raise channel.error("clips_at", greatest, "expected the greatest sample, more than 0")
        names.append(name)
        scales.append(scale)
        clips_at.append(greatest * scale)
    if ACCELERATION not in names:
        raise SensorError(f"{source}: channels: has no channel named 'acceleration'; declare which one it is")
    return SensorForm(rate_hz, tuple(names), tuple(clips_at), is_simulated), np.array(scales)
