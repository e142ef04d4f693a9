"""Fit of a table to the connected board: what differs between the two is played as it is, scaled, or refused.

A table is made for the actuators of its device file, and its amplitudes are fractions of their full scales. HELLO says
what the connected board calls full scale. Where the two differ, the same fraction is another displacement: a board of
2.6 um would play a table for 0.52 um five times (14 dB) too strong. For each actuator, with r the table's full scale
divided by the board's:

- **r within TOLERANCE of 1: played as it is.** That much lies between a board's nominal full scale and the one that a
  calibration of its bar finds. The calibrated value is the better one, so scaling would make it wrong.
- **otherwise, down to 1 / GREATEST_RATIO, and up as far as the board moves: scaled by r.** Drives, functions of clicks
  and the limits in ARM are scaled alike, so the displacements, and where they are clamped, are those of the table. `up`
  ends where the table's limit would be more than the board's full scale.
- **beyond: refused**, with what to do. A ratio above GREATEST_RATIO is a unit mistake, or another device.

Scaling and everything else that a user should know is said in a note.

Of the basis of clicks the board gets the part that it, over its line, can hold and play. Its functions are scaled; the
weights of clicks, which are what travels, stay as they are. A scale above 1 could take a function beyond its 16 bits.
So the functions are then halved until no scale is above 1, and a PLAY has as many fraction bits less, which doubles
them back.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from base.errors import TactableError
from engine.device import Device
from firmware_link.host.link_values import BOARD_SOUND_CARD, Capabilities
from firmware_link.protocol.basis import Basis, encode_basis
from firmware_link.protocol.framing import encode_message, occupied_ns
from firmware_link.protocol.messages import LINEARISES, PM_PER_M, Features, Play

TOLERANCE = 0.1  # 0.9 dB, less than the smallest difference in level that a finger tells (about 1.5 dB)
GREATEST_RATIO = 10.0  # the example above is a factor of 5, a wrong unit one of 25 (inch) or 1000
COARSEST_STEP = 0.01  # of the lowest frequency; rounding moves it by half of that, as 1 % of stiffness does
LEAST_SAMPLES_A_PERIOD = 10  # held samples are an amplitude of sinc(1 / 10): 0.14 dB are lost
_UM_PER_M = 1e6
MOST_OF_LEASE = 0.5  # share of the lease that a PLAY may take on the line: an older command is refused


class RendererError(TactableError, ValueError):
    """The table, the device description and the connected device do not belong together; the message has the remedy."""


@dataclass(frozen=True)
class BoardFit:
    """How the amplitudes of a table are played on one board."""

    scales: tuple[float, ...]  # by actuator, on amplitudes that are fractions of the table's full scale
    notes: tuple[str, ...] = ()  # what a user should know, one sentence each


def fit_board(device: Device, capabilities: Capabilities) -> BoardFit:
    """Compare a table's device with the connected board; raises RendererError for a board that cannot play it."""
    _check_actuators(device, capabilities)
    check_frequencies(device, capabilities, (device.sweep.start_hz, device.sweep.stop_hz))
    _check_synthesis_rate(device, capabilities)
    _check_linearisation(device, capabilities)
    is_card = capabilities.board == BOARD_SOUND_CARD
    scales = scales_for(device, capabilities.full_scales_m, is_card=is_card)
    notes = _notes_on_others(device, capabilities)
    if set(scales) == {1.0}:
        return BoardFit(scales, notes)
    apart = max(range(len(scales)), key=lambda index: abs(math.log(scales[index])))
    factors = ", ".join(f"{scale:.3g}" for scale in scales)
    note = (
        f"{_difference(device, capabilities.full_scales_m, apart)}; amplitudes are multiplied by {factors}, so that "
        f"displacements are the table's. If the table comes from a calibration of this board, {_way(device, is_card)}"
    )
    return BoardFit(scales, (note, *notes))


def scales_for(device: Device, full_scales_m: Sequence[float], *, is_card: bool = False) -> tuple[float, ...]:
    """By actuator: what amplitudes are multiplied with on a board of these full scales, which may have more actuators.

    A sound card (`is_card`) is told its full scale by the name of its port, and has nothing to flash. Raises
    RendererError for a board that cannot play the displacements of the table.
    """
    ratios = [
        actuator.full_scale_m / board_m if board_m > 0 else math.inf
        for actuator, board_m in zip(device.actuators, full_scales_m, strict=False)
    ]
    scales = tuple(1.0 if 1 / (1 + TOLERANCE) <= ratio <= 1 + TOLERANCE else ratio for ratio in ratios)
    for index, scale in enumerate(scales):
        remedy = f"connect the board of {device.name}, or {_way(device, is_card)} if that is what it does"
        if not 1 / GREATEST_RATIO <= scale <= GREATEST_RATIO:
            raise RendererError(f"{_difference(device, full_scales_m, index)}: {remedy}")
        if scale * device.limits.amplitude > 1:
            raise RendererError(
                f"{_difference(device, full_scales_m, index)}, which is too little for the table's amplitude limit of "
                f"{100 * device.limits.amplitude:.3g} %: {remedy}; or lower limits.amplitude to {100 / scale:.3g} %"
            )
    return scales


def check_frequencies(device: Device, capabilities: Capabilities, range_hz: tuple[float, float]) -> None:
    """Check that the board plays what lies in this range and in the actuators' bands, and does not move it elsewhere.

    A board clamps a frequency to its own range and says nothing. Raises RendererError.
    """
    step_hz = capabilities.frequency_resolution_hz
    low_hz, high_hz = capabilities.frequency_minimum_hz, capabilities.frequency_maximum_hz
    for actuator in device.actuators:
        lowest_hz, highest_hz = max(range_hz[0], actuator.band_hz[0]), min(range_hz[1], actuator.band_hz[1])
        if lowest_hz > highest_hz:
            continue
        name = f"{device.name}: actuator {actuator.name} may be driven at {lowest_hz:g}-{highest_hz:g} Hz"
        if not 0 < step_hz <= COARSEST_STEP * lowest_hz:
            raise RendererError(
                f"{name}; the connected board has frequencies {step_hz:g} Hz apart, expected at most "
                f"{COARSEST_STEP * lowest_hz:g} Hz: flash a finer frequency resolution"
            )
        # The wire counts in whole steps: a frequency at the end of the range may be off by rounding.
        if lowest_hz < low_hz - step_hz / 2 or highest_hz > high_hz + step_hz / 2:
            raise RendererError(
                f"{name}; the connected device plays {low_hz:g}-{high_hz:g} Hz: narrow the actuators' bands in the "
                "device description and build the table again"
            )


def card_text(device: Device) -> str:
    """The full scales of a device as the port of a sound card says them (docs/audio.md)."""
    return f"full_scale={'+'.join(f'{_UM_PER_M * each.full_scale_m:.4g} um' for each in device.actuators)}"


def _way(device: Device, is_card: bool) -> str:
    return f"give --port {card_text(device)}" if is_card else f"flash {flash_text(device)}"


def flash_text(device: Device) -> str:
    """The full scales of a device as a board file (firmware_link/firmware/boards) says them."""
    return f"full_scales_pm = {{{', '.join(str(round(PM_PER_M * each.full_scale_m)) for each in device.actuators)}}}"


def _difference(device: Device, full_scales_m: Sequence[float], index: int) -> str:
    actuator = device.actuators[index]
    return (
        f"{device.name}: full scale of actuator {actuator.name} is {_UM_PER_M * actuator.full_scale_m:.3g} um in the "
        f"table and {_UM_PER_M * full_scales_m[index]:.3g} um on the connected board"
    )


def _check_actuators(device: Device, capabilities: Capabilities) -> None:
    if capabilities.number_of_actuators < len(device.actuators):
        raise RendererError(
            f"{device.name} has {len(device.actuators)} actuators, the connected device drives "
            f"{capabilities.number_of_actuators}: connect its own device or choose another description"
        )


def _check_synthesis_rate(device: Device, capabilities: Capabilities) -> None:
    highest_hz = min(max(actuator.band_hz[1] for actuator in device.actuators), capabilities.frequency_maximum_hz)
    if capabilities.synthesis_rate_hz < LEAST_SAMPLES_A_PERIOD * highest_hz:
        raise RendererError(
            f"{device.name}: its actuators are driven at up to {highest_hz:g} Hz, and the connected board makes only "
            f"{capabilities.synthesis_rate_hz} samples a second; expected {LEAST_SAMPLES_A_PERIOD} a period or more: "
            "connect a faster board, or narrow the bands in the device description and build the table again"
        )


def _check_linearisation(device: Device, capabilities: Capabilities) -> None:
    """The square law of electrodes is undone once: a board that does it beside an amplifier distorts as one without."""
    of_board = LINEARISES in capabilities.features
    for actuator in device.actuators:
        electrodes = actuator.electrodes
        if electrodes is None or (electrodes.linearised_by == "board") is of_board:
            continue
        key = f"{device.name}: actuator {actuator.name}: electrodes.linearised_by is {electrodes.linearised_by!r}"
        if of_board:
            raise RendererError(f"{key}, and the connected board linearises: say 'board', or flash electrode_bias = 0")
        raise RendererError(f"{key}, and the connected board does not: flash electrode_bias = {electrodes.bias_word}")


def _notes_on_others(device: Device, capabilities: Capabilities) -> tuple[str, ...]:
    notes = []
    silent = capabilities.number_of_actuators - len(device.actuators)
    if silent:
        notes.append(f"the connected board drives {silent} more than the actuators of {device.name}; they stay silent")
    lease_ms = 1e3 * device.limits.lease_s
    if capabilities.longest_lease_ms < math.floor(lease_ms):
        notes.append(
            f"the connected board allows leases of {capabilities.longest_lease_ms} ms, and {device.name} asks for "
            f"{lease_ms:g} ms: a drive ends {capabilities.longest_lease_ms} ms after its last renewal"
        )
    return tuple(notes)


@dataclass(frozen=True)
class ChosenBasis:
    """The basis that a device is to hold, None for none, and the number in it of each set of the table's basis."""

    basis: Basis | None
    sets: Mapping[int, int]
    halvings: int = 0  # how often the device's functions are halved; each takes one fraction bit off a PLAY


NO_BASIS = ChosenBasis(None, {})


def choose_basis(whole: Basis | None, capabilities: Capabilities, bit_rate_hz: int, lease_ms: int) -> ChosenBasis:
    """The sets that fit into the device's memory, last no longer than it plays, whose PLAY the line carries in time.

    They are taken in the order of the table's basis, in which lengths are preferred. A device that plays no clicks, or
    makes fewer samples a second than a click has, gets none.
    """
    plays_clicks = Features.WAVEFORMS in capabilities.features
    if whole is None or not plays_clicks or capabilities.synthesis_rate_hz < whole.sample_rate_hz:
        return NO_BASIS
    chosen = list[int]()
    for number, each in enumerate(whole.sets):
        length_ms = 1e3 * (each.samples - 1) / whole.sample_rate_hz
        slow_ms = 1e-6 * play_ns(len(each.actuators), bit_rate_hz)
        if length_ms > capabilities.longest_waveform_ms or slow_ms > MOST_OF_LEASE * lease_ms:
            continue
        if len(encode_basis(_part(whole, [*chosen, number]))) <= capabilities.basis_capacity_bytes:
            chosen.append(number)
    if not chosen:
        return NO_BASIS
    return ChosenBasis(_part(whole, chosen), {number: place for place, number in enumerate(chosen)})


def scaled(chosen: ChosenBasis, scales: Sequence[float]) -> ChosenBasis:
    """The same with the functions of each actuator multiplied by its scale, then halved until none is greater."""
    if chosen.basis is None or set(scales) == {1.0}:
        return chosen
    halvings = max(0, math.ceil(math.log2(max(scales))))
    sets = []
    for each in chosen.basis.sets:
        factors = np.array(scales)[each.actuators] / 2**halvings
        sets.append(replace(each, functions=np.rint(each.functions * factors[:, None]).astype(np.int16)))
    return ChosenBasis(Basis(chosen.basis.sample_rate_hz, tuple(sets)), chosen.sets, halvings)


def play_ns(weights: int, bit_rate_hz: int) -> int:
    """Duration for which a PLAY with this number of weights occupies a serial line."""
    return occupied_ns(bit_rate_hz, len(encode_message(Play(0, 0, 1, 0, weights, (0,) * weights), 0)))


def _part(basis: Basis, numbers: Sequence[int]) -> Basis:
    if len(numbers) == len(basis.sets):
        return basis
    return Basis(basis.sample_rate_hz, tuple(basis.sets[number] for number in numbers))
