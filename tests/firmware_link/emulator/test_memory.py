"""Laws of a device's memory for clicks: a transfer bears copies, and never lies on the basis that is held."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from firmware_link.emulator.memory import BasisStore
from firmware_link.protocol.basis import Basis, BasisSet, encode_basis, transfer_messages
from firmware_link.protocol.messages import BasisBegin, BasisChunk, BasisCommit, Result
from tests.firmware_link.strategies import bases, unhurried

ACTUATORS = 3  # as in `bases`


def silence(samples: int) -> Basis:
    return Basis(1000, (BasisSet(np.zeros((1, samples), np.int16), np.zeros(1, np.uint8)),))


def transfer(store: BasisStore, *steps: BasisBegin | BasisChunk | BasisCommit) -> list[Result]:
    results = []
    for step in steps:
        match step:
            case BasisBegin():
                results.append(store.begin_basis(step, may_forget=True))
            case BasisChunk():
                results.append(store.append_chunk(step))
            case BasisCommit():
                results.append(store.commit(step))
    return results


@unhurried
@given(bases(), st.integers(1, 3))
def test_a_transfer_of_any_copies_holds_the_basis(basis: Basis, copies: int) -> None:
    store = BasisStore(1 << 16, 60_000, ACTUATORS)
    steps = [step for step in transfer_messages(basis.data) for _ in range(copies)]
    assert set(transfer(store, *steps)) == {Result.OK}
    assert store.held_hash == basis.hash
    assert store.basis is not None
    assert encode_basis(store.basis) == basis.data


@unhurried
@given(bases(), st.data())
def test_a_transfer_with_a_wrong_byte_holds_nothing(basis: Basis, data: st.DataObject) -> None:
    store = BasisStore(1 << 16, 60_000, ACTUATORS)
    content = bytearray(basis.data)
    begin, *_, commit = transfer_messages(bytes(content))
    content[data.draw(st.integers(0, len(content) - 1))] ^= data.draw(st.integers(1, 255))
    _, *chunks, _ = transfer_messages(bytes(content))
    assert transfer(store, begin, *chunks, commit)[-1] is Result.WRONG_HASH
    assert (store.basis, store.held_hash) == (None, 0)


@given(st.lists(st.tuples(st.integers(1, 9), st.booleans()), min_size=1, max_size=12))
def test_a_basis_in_transfer_never_lies_on_the_one_that_is_held(steps: list[tuple[int, bool]]) -> None:
    """Bases of a few hundred bytes in a memory for three of the smallest; as if they lay in one run of bytes."""
    small = silence(20).data
    store = BasisStore(3 * len(small), 1000, 1)
    for size, may_forget in steps:
        basis = silence(4 * size + 2)
        data = basis.data
        begin, *rest = transfer_messages(data)
        assert isinstance(begin, BasisBegin)
        before = (store.held_hash, store._held_at, store._held_size)
        result = store.begin_basis(begin, may_forget)
        held, held_at, held_size = before
        fits_beside = not held or len(data) <= held_at or len(data) <= 3 * len(small) - held_at - held_size
        if result is not Result.OK:
            assert len(data) > 3 * len(small) or (not may_forget and not fits_beside)
            continue
        assert (store.held_hash == held) == fits_beside or not held
        if store.held_hash:
            start, stop = store._transfer_at, store._transfer_at + len(data)
            assert stop <= held_at or start >= held_at + held_size
            assert stop <= 3 * len(small)
        for message in rest:
            assert transfer(store, message) == [Result.OK]
        assert store.held_hash == basis.hash
        assert 0 <= store._held_at <= 3 * len(small) - len(data)
