"""The sound cards of this machine, by PortAudio; without arrays, since `list` shows them."""

import contextlib
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

from tactable.audio.names import AudioError


@dataclass(frozen=True)
class Interface:
    """A card as PortAudio shows it: number, name, channels, preferred rate, and its driver's least latency.

    In the name ALSA's number of the card, which another one may have after the next start, is replaced by its id.
    """

    index: int
    name: str
    outputs: int
    inputs: int
    rate_hz: float
    output_latency_s: float


def load_portaudio() -> ModuleType:
    """The module sounddevice. Raises AudioError with the remedy where it or the library PortAudio is not installed."""
    try:
        with quiet():
            import sounddevice
    except ModuleNotFoundError:
        raise AudioError("sound cards need sounddevice: run `pip install 'tactable[audio]'`") from None
    except OSError:
        raise AudioError("sound cards need the library PortAudio: run `sudo apt install libportaudio2`") from None
    except Exception as error:  # PortAudioError, which no name can be imported of: PortAudio starts with the module
        raise AudioError(f"sound cards: PortAudio does not start ({error}): restart the sound system") from None
    module: ModuleType = sounddevice
    return module


def find_interfaces(module: ModuleType | None = None, cards: Path = Path("/proc/asound")) -> tuple[Interface, ...]:
    """Every card that PortAudio shows; `cards`: where ALSA tells their ids. Raises AudioError as `load_portaudio`."""
    module = module or load_portaudio()
    try:
        found = module.query_devices()
    except module.PortAudioError as error:
        raise AudioError(f"sound cards: PortAudio does not list them ({error}): restart the sound system") from None
    return tuple(
        Interface(
            index,
            _stable(device["name"], cards),
            device["max_output_channels"],
            device["max_input_channels"],
            device["default_samplerate"],
            device["default_low_output_latency"],
        )
        for index, device in enumerate(found)
    )


def _stable(name: str, cards: Path) -> str:
    """The name with the id of its card, as in hw:Device,0, in place of a number, as in hw:1,0."""

    def card_id(found: re.Match[str]) -> str:
        try:
            return (cards / f"card{found[0]}" / "id").read_text(encoding="utf-8").strip() or found[0]
        except OSError:
            return found[0]

    return re.sub(r"(?<=\(hw:)\d+(?=,\d+\))", card_id, name)


def select_interface(
    name: str, interfaces: tuple[Interface, ...], *, is_input: bool, is_exact: bool = False
) -> Interface:
    """The card of a direction of this name, or the only one with it as a part, unless `is_exact`. Raises AudioError."""
    interfaces = tuple(each for each in interfaces if (each.inputs if is_input else each.outputs))
    exact = [each for each in interfaces if name == each.name]
    matching = exact if exact or is_exact else [each for each in interfaces if name.casefold() in each.name.casefold()]
    if len(matching) == 1:
        return matching[0]
    if not matching:
        known = "; ".join(each.name for each in interfaces) or "none"
        what = "inputs" if is_input else "outputs"
        raise AudioError(f"no sound card {name!r} with {what}: plug it in, or take one of these: {known}")
    names = "; ".join(each.name for each in matching)
    raise AudioError(f"sound card {name!r} is the name of several: take more of the name of one of {names}")


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Keep what ALSA writes about cards that are not there off the standard error."""
    kept = os.dup(2)
    with Path(os.devnull).open("wb") as nothing:
        os.dup2(nothing.fileno(), 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
