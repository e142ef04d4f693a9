"""The text that names a sound card on the command line, to what it is and what its samples stand for.

    audio:NAME,full_scale=0.6 um,most=50 %                                 a card that drives actuators (--port)
    audio:NAME,acceleration=1,scale=98.1 m/s^2,loopback=2                  a card that reads a sensor (--sensor)

NAME may have commas of its own, as names of ALSA do. A card cannot say what its samples do, so that what a sample of 1
stands for, and the greatest sample, have no default: without them the text is refused.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from firmware_link.protocol.link_errors import LinkError

PREFIX = "audio:"
SIMULATED = "simulated"  # The name of a card that is not there: it takes samples at the pace of the clock. SIMULATED.
_MOST_CHANNELS = 64  # TACTABLE_ACTUATORS of the core that board.py compiles
_LEAST_RATE_HZ, _GREATEST_RATE_HZ = 8_000, 192_000  # what sound cards have; a click to 300 Hz needs 3 kHz
_LEAST_BLOCK_S, _GREATEST_BLOCK_S = 0.001, 0.02  # docs/audio.md; a command waits for a block: half a lease at most
_OUTPUT_KEYS = ("full_scale", "most", "channels", "rate", "block")
_OF_TAPS = {"force": "N", "reference": "m/s^2"}  # units of further channels: a hammer's load cell, a fixed sensor
_INPUT_KEYS = (
    "acceleration",
    "scale",
    "loopback",
    "loopback_scale",
    "rate",
    *_OF_TAPS,
    *(f"{key}_scale" for key in _OF_TAPS),
)


class AudioError(LinkError):
    """A sound card cannot be used; the message names it, the place and the remedy."""


@dataclass(frozen=True)
class AudioOutput:
    """A card as a board. full_scales_m: base displacement by actuator at a sample of 1; most: the greatest sample.

    channels: of the card by actuator, the first is 0. block: samples of one callback.
    """

    name: str
    full_scales_m: tuple[float, ...]
    most: float
    channels: tuple[int, ...]
    rate_hz: int = 48_000
    block: int = 256

    @property
    def is_simulated(self) -> bool:
        """Whether the name stands for a simulated card."""
        return self.name == SIMULATED


@dataclass(frozen=True)
class AudioInput:
    """A card as the converter of a sensor; channels count from 0.

    acceleration: channel of the sensor, scale_m_per_s2: what a sample of 1 is there. loopbacks: the channels on which
    the outputs of the board come back, one that has them all through equal resistors or one for each actuator;
    loopback_scale: what fraction of full scale a sample of 1 is there. further: name, channel and scale in SI of the
    load cell of a hammer ("force"), and of an accelerometer that stays in place ("reference").
    """

    name: str
    acceleration: int
    scale_m_per_s2: float
    loopbacks: tuple[int, ...] = ()
    loopback_scale: float = 1.0
    rate_hz: int = 48_000
    further: tuple[tuple[str, int, float], ...] = ()

    @property
    def is_simulated(self) -> bool:
        """Whether the name stands for a simulated card."""
        return self.name == SIMULATED


def is_audio(text: str) -> bool:
    """Whether a port or sensor is a sound card."""
    return text.startswith(PREFIX)


def parse_output(text: str) -> AudioOutput:
    """The card of a --port. Raises AudioError, which names the word, its place and the remedy."""
    name, words = _split(text, _OUTPUT_KEYS)
    for key, what in (
        ("full_scale", "the base displacement of an actuator at a sample of 1, such as full_scale=0.6 um"),
        ("most", "the greatest sample that the amplifier and actuators bear, such as most=50 %"),
    ):
        if key not in words:
            raise AudioError(f"{text}: {key} is missing; declare {what}")
    channels = _channels(text, words, "channels", "1+2")
    full_scales_m = tuple(_quantity(text, "full_scale", part, "m") for part in words["full_scale"].split("+"))
    if len(full_scales_m) == 1:
        full_scales_m *= len(channels)
    if len(full_scales_m) != len(channels):
        raise AudioError(f"{text}: full_scale: {len(full_scales_m)} for {len(channels)} channels; give one or one each")
    most = _quantity(text, "most", words["most"], "")
    if most > 1:
        raise AudioError(f"{text}: most={words['most']}: a card has no sample above 100 %; give that or less")
    rate_hz = _rate(text, words)
    block_s = _quantity(text, "block", words.get("block", "5 ms"), "s")
    if not _LEAST_BLOCK_S <= block_s <= _GREATEST_BLOCK_S:
        raise AudioError(f"{text}: block={words['block']}: expected 1 ms to 20 ms")
    return AudioOutput(name, full_scales_m, most, channels, rate_hz, round(block_s * rate_hz))


def parse_input(text: str, actuators: Sequence[str]) -> AudioInput:
    """The card of a --sensor; actuators: their names, in order. Raises AudioError as `parse_output`."""
    name, words = _split(text, _INPUT_KEYS)
    if "scale" not in words:
        raise AudioError(
            f"{text}: scale is missing; declare the acceleration that a sample of 1 stands for, such as "
            "scale=98.1 m/s^2 (sensitivity of sensor and preamplifier)"
        )
    (acceleration, *others) = _channels(text, words, "acceleration", "1")
    loopbacks = _channels(text, words, "loopback", "") if "loopback" in words else ()
    if others:
        raise AudioError(f"{text}: acceleration={words['acceleration']}: expected one channel")
    if len(loopbacks) not in (0, 1, len(actuators)):
        raise AudioError(
            f"{text}: loopback={words['loopback']}: expected one channel that has all outputs, or one for each of "
            f"{', '.join(actuators)}"
        )
    further = tuple(_further(text, words, name, unit) for name, unit in _OF_TAPS.items() if name in words)
    used = [acceleration, *loopbacks, *(channel for _, channel, _ in further)]
    if twice := [channel for channel in used if used.count(channel) > 1]:
        what = "both acceleration and loopback" if not further else "named twice"
        raise AudioError(f"{text}: channel {twice[0] + 1} is {what}; use two channels")
    scale = _quantity(text, "scale", words["scale"], "m/s^2")
    loopback_scale = _quantity(text, "loopback_scale", words.get("loopback_scale", "100 %"), "")
    return AudioInput(name, acceleration, scale, loopbacks, loopback_scale, _rate(text, words), further)


def _further(text: str, words: Mapping[str, str], name: str, unit: str) -> tuple[str, int, float]:
    key = f"{name}_scale"
    if key not in words:
        raise AudioError(
            f"{text}: {key} is missing; declare what a sample of 1 stands for there, such as {key}=50 {unit}"
        )
    (channel, *others) = _channels(text, words, name, "")
    if others:
        raise AudioError(f"{text}: {name}={words[name]}: expected one channel")
    return name, channel, _quantity(text, key, words[key], unit)


def _split(text: str, keys: Sequence[str]) -> tuple[str, Mapping[str, str]]:
    """The name and the words behind it."""
    parts = text.removeprefix(PREFIX).split(",")
    first = next((i for i, part in enumerate(parts) if "=" in part), len(parts))
    name, words = ",".join(parts[:first]).strip(), dict[str, str]()
    if not name:
        raise AudioError(f"{text}: names no sound card; take one that `tactable list` shows, or {PREFIX}{SIMULATED}")
    for part in parts[first:]:
        key, _, value = (piece.strip() for piece in part.partition("="))
        if key not in keys or key in words:
            raise AudioError(f"{text}: {part.strip()!r}: expected each once of {', '.join(keys)}, as in full_scale=1um")
        words[key] = value
    return name, words


def _channels(text: str, words: Mapping[str, str], key: str, default: str) -> tuple[int, ...]:
    shown = words.get(key, default)
    numbers = [int(part) if part.strip().isdecimal() else 0 for part in shown.split("+")]
    if not all(1 <= number <= _MOST_CHANNELS for number in numbers) or len(set(numbers)) < len(numbers):
        raise AudioError(f"{text}: {key}={shown}: expected different channels, counted from 1, such as 1+2")
    return tuple(number - 1 for number in numbers)


def _rate(text: str, words: Mapping[str, str]) -> int:
    rate_hz = _quantity(text, "rate", words.get("rate", "48 kHz"), "Hz")
    if not _LEAST_RATE_HZ <= rate_hz <= _GREATEST_RATE_HZ:
        raise AudioError(f"{text}: rate={words['rate']}: expected 8 kHz to 192 kHz")
    return round(rate_hz)


def _quantity(text: str, key: str, value: str, unit: str) -> float:
    from engine.device.quantity import QuantityError, read_quantity  # `list` names cards, and needs no arrays for that

    try:
        found = read_quantity(value.strip(), unit)
    except QuantityError as error:
        raise AudioError(f"{text}: {key}: {error}") from None
    if not found > 0:
        raise AudioError(f"{text}: {key}={value}: expected more than 0")
    return found
