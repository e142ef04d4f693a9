"""Basis of a table's clicks to the part of it that one device, over one line, can hold and play.

A board of another full scale gets scaled functions (engine.render.board_fit). The weights of clicks, which are what
travels, stay as they are. A scale above 1 could take a function beyond its 16 bits. So the functions are then halved
until no scale is above 1, and a PLAY has as many fraction bits less, which doubles them back.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from firmware_link.host.link_values import Capabilities
from firmware_link.protocol.basis import Basis, encode_basis
from firmware_link.protocol.framing import encode_message
from firmware_link.protocol.line_rate import occupied_ns
from firmware_link.protocol.messages import Features, Play

MOST_OF_LEASE = 0.5  # share of the lease that a PLAY may take on the line: an older command is refused


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
