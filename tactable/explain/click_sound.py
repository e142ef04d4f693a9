"""Sound of a click: the acceleration of every finger in the nominal plant, as a .wav file."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.io import wavfile

from base.arrays import Array
from base.errors import TactableError
from engine.device import Device
from engine.table import ClickEntry
from engine.touch import Placement
from precompute.clicks.click_basis import RINGDOWN_S
from precompute.model.assembly import assemble
from precompute.model.modal import compute_basis
from precompute.model.threshold_filter import threshold_filter
from precompute.model.transient import TransientPlant
from tactable.explain.click_course import played_displacement
from tactable.explain.words import finger_names

SOUND_RATE_HZ = 48_000  # every player has it, and it is a multiple of the rate of waveforms
PAUSE_S = 0.5
"""Pause between one finger and the next."""
LOUDEST = 0.9 * 32_767
"""Greatest sample: converters overshoot between samples."""
_CHANNEL_NAMES = {1: "one after another", 2: "felt left, quiet right"}


class SoundError(TactableError):
    """A sound cannot be made as asked; the message names the file or option and the remedy."""


@dataclass(frozen=True, eq=False)
class Sound:
    """Samples (time, channel) at SOUND_RATE_HZ with one scale: LOUDEST stands for `loudest_value`.

    `order` names the fingers in the order of hearing, or of the channels.
    """

    samples: NDArray[np.int16]
    loudest_value: float
    is_weighted: bool
    order: tuple[str, ...]

    @property
    def words(self) -> str:
        """Description in one line."""
        if self.is_weighted:
            heard = f"acceleration weighted by the detection threshold, greatest {self.loudest_value:.3g} times it"
        else:
            heard = f"acceleration, greatest {self.loudest_value:.3g} m/s²"
        return f"{', '.join(self.order)} ({_CHANNEL_NAMES[self.samples.shape[1]]}): {heard}"


def check_sound_path(path: Path) -> None:
    """Raise SoundError for another ending or a folder that does not exist, before work is done."""
    if path.suffix.lower() != ".wav":
        raise SoundError(f"{path}: a sound ends in .wav; choose such a name")
    if not path.parent.is_dir():
        raise SoundError(f"{path.parent}: no such folder; create it or choose another output")


def make_sound(device: Device, click: ClickEntry, placement: Placement, *, is_weighted: bool, is_stereo: bool) -> Sound:
    """Make the sound of felt fingers, then of quiet ones, a pause between; in stereo felt is left and quiet right.

    The fingers are those of the placement. Raises SoundError for stereo of other than one felt and one quiet finger.
    """
    order = [*placement.felt, *placement.quiet]
    if is_stereo and (len(placement.felt), len(placement.quiet)) != (1, 1):
        raise SoundError("--stereo is for one felt and one quiet finger; without it all are heard one after another")
    heard = compute_felt(device, click, placement.position_m, is_weighted=is_weighted)[:, order]
    if not is_stereo:
        pause = np.zeros((round(PAUSE_S * SOUND_RATE_HZ), len(order)))
        heard = np.concatenate([heard, pause]).T.reshape(-1, 1)
    loudest = float(abs(heard).max())
    samples = np.rint(heard * (LOUDEST / loudest)).astype(np.int16)
    names = finger_names(device, placement)
    return Sound(samples, loudest, is_weighted, tuple(names[finger] for finger in order))


def compute_felt(device: Device, click: ClickEntry, position_m: Sequence[complex], *, is_weighted: bool) -> Array:
    """Simulate the acceleration (time, finger) at SOUND_RATE_HZ, in m/s^2 or over threshold, until it has died down.

    The plant is the nominal one, with standard fingers at these positions.
    """
    plant = TransientPlant(compute_basis(assemble(device)), np.array(position_m), SOUND_RATE_HZ)
    plant.touch([(at_m, device.finger) for at_m in position_m])
    drive = played_displacement(click)
    sample_s = np.arange(len(drive)) / click.sample_rate_hz
    time_s = np.arange(round((click.length_s + RINGDOWN_S) * SOUND_RATE_HZ)) / SOUND_RATE_HZ
    acceleration = plant.accelerate(np.column_stack([np.interp(time_s, sample_s, column) for column in drive.T]))
    if not is_weighted:
        return acceleration
    taps = threshold_filter(device.threshold, SOUND_RATE_HZ)
    return np.stack([np.convolve(course, taps)[: len(course)] for course in acceleration.T], axis=1)


def sound_json(sound: Sound) -> dict[str, object]:
    """Description as plain values; `loudest_value` is over threshold or in m/s^2."""
    return {
        "fingers": list(sound.order),
        "channels": sound.samples.shape[1],
        "is_weighted": sound.is_weighted,
        "loudest_value": sound.loudest_value,
        "loudest_sample": round(LOUDEST),
        "sample_rate_hz": SOUND_RATE_HZ,
    }


def write_sound(sound: Sound, path: Path) -> None:
    """Write a .wav file of 16-bit PCM."""
    wavfile.write(path, SOUND_RATE_HZ, sound.samples)
