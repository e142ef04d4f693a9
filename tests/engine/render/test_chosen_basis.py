"""Laws of the part of a basis that a device and its line carry."""

from dataclasses import replace

import numpy as np
import pytest

from engine.render.board_fit import NO_BASIS, choose_basis
from firmware_link.protocol.basis import Basis, BasisSet
from firmware_link.protocol.messages import Features
from tests.engine.render.boards import board

CAPABILITIES = board()
RATE_HZ, LEASE_MS = 115_200, 40


def whole(*shapes: tuple[int, int]) -> Basis:
    """A basis of sets with so many functions and samples."""
    sets = tuple(BasisSet(np.zeros(shape, np.int16), (np.arange(shape[0]) % 2).astype(np.uint8)) for shape in shapes)
    return Basis(4000, sets)


def test_a_basis_that_fits_is_held_as_it_is() -> None:
    basis = whole((44, 121), (80, 241))
    chosen = choose_basis(basis, CAPABILITIES, RATE_HZ, LEASE_MS)
    assert chosen.basis is basis
    assert chosen.sets == {0: 0, 1: 1}


@pytest.mark.parametrize(
    ("changed", "rate_hz"),
    [
        ({"longest_waveform_ms": 30}, RATE_HZ),
        ({"basis_capacity_bytes": 30_000}, RATE_HZ),
        ({}, 57_600),  # 44 weights take 18 ms, 80 take 31
    ],
)
def test_sets_that_do_not_fit_are_left_out_and_others_keep_their_order(changed: dict[str, int], rate_hz: int) -> None:
    basis = whole((80, 241), (44, 121), (40, 121))
    chosen = choose_basis(basis, replace(CAPABILITIES, **changed), rate_hz, LEASE_MS)  # type: ignore[arg-type]
    assert chosen.sets == {1: 0, 2: 1}
    assert chosen.basis is not None
    assert [len(each.actuators) for each in chosen.basis.sets] == [44, 40]


@pytest.mark.parametrize(
    ("changed", "rate_hz"),
    [
        ({"features": Features(0)}, RATE_HZ),
        ({"basis_capacity_bytes": 100}, RATE_HZ),
        ({"longest_waveform_ms": 20}, RATE_HZ),
        ({"synthesis_rate_hz": 3999}, RATE_HZ),
        ({}, 38_400),
    ],
)
def test_a_device_or_line_that_carries_no_click_gets_no_basis(changed: dict[str, int], rate_hz: int) -> None:
    basis = whole((44, 121))
    assert choose_basis(basis, replace(CAPABILITIES, **changed), rate_hz, LEASE_MS) == NO_BASIS  # type: ignore[arg-type]
    assert choose_basis(None, CAPABILITIES, RATE_HZ, LEASE_MS) == NO_BASIS
