"""Laws of a device's memory for waveforms: a transfer bears copies, and never lies on the bank that is held."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from firmware_link.emulator.memory import BankStore
from firmware_link.protocol.bank import Bank, encode_bank, hash_of_bank, make_bank, transfer_messages
from firmware_link.protocol.messages import BANK_CHUNK_SIZE, BankBegin, BankChunk, BankCommit, Result
from tests.firmware_link.strategies import banks, unhurried

ACTUATORS = 3  # as in `banks`


def transfer(store: BankStore, *steps: BankBegin | BankChunk | BankCommit) -> list[Result]:
    results = []
    for step in steps:
        match step:
            case BankBegin():
                results.append(store.begin(step, may_forget=True))
            case BankChunk():
                results.append(store.take(step))
            case BankCommit():
                results.append(store.commit(step))
    return results


@unhurried
@given(banks(), st.integers(1, 3))
def test_a_transfer_of_any_copies_holds_the_bank(bank: Bank, copies: int) -> None:
    store = BankStore(1 << 16, 60_000, ACTUATORS)
    data = encode_bank(bank, ACTUATORS)
    steps = [step for step in transfer_messages(data) for _ in range(copies)]
    assert set(transfer(store, *steps)) == {Result.OK}
    assert store.held_hash == hash_of_bank(data)
    assert store.bank is not None
    assert encode_bank(store.bank, ACTUATORS) == data


@unhurried
@given(banks(), st.data())
def test_a_transfer_with_a_wrong_byte_holds_nothing(bank: Bank, data: st.DataObject) -> None:
    store = BankStore(1 << 16, 60_000, ACTUATORS)
    content = bytearray(encode_bank(bank, ACTUATORS))
    begin, *_, commit = transfer_messages(bytes(content))
    content[data.draw(st.integers(0, len(content) - 1))] ^= data.draw(st.integers(1, 255))
    _, *chunks, _ = transfer_messages(bytes(content))
    assert transfer(store, begin, *chunks, commit)[-1] is Result.WRONG_HASH
    assert (store.bank, store.held_hash) == (None, 0)


def test_a_waveform_longer_than_the_device_plays_is_out_of_range() -> None:
    store = BankStore(1 << 16, 10, 1)
    for samples, result in ((11, Result.OK), (12, Result.OUT_OF_RANGE)):
        steps = transfer_messages(encode_bank(make_bank(1000, [np.zeros((samples, 1))]), 1))
        assert transfer(store, *steps)[-1] is result


def test_chunks_out_of_order_are_refused() -> None:
    store = BankStore(1 << 16, 10, 1)
    chunk = bytes(BANK_CHUNK_SIZE)
    steps = (
        BankBegin(1, 500),
        BankChunk(0, chunk),
        BankChunk(384, chunk),
        BankChunk(100, chunk),
        BankChunk(192, chunk),
    )
    assert transfer(store, *steps) == [Result.OK, Result.OK, Result.OUT_OF_RANGE, Result.OUT_OF_RANGE, Result.OK]
    assert transfer(store, BankChunk(384, chunk), BankChunk(576, chunk)) == [Result.OK, Result.OUT_OF_RANGE]


@given(st.lists(st.tuples(st.integers(1, 9), st.booleans()), min_size=1, max_size=12))
def test_a_bank_in_transfer_never_lies_on_the_one_that_is_held(steps: list[tuple[int, bool]]) -> None:
    """Banks of a few hundred bytes in a memory for three of the smallest; as if they lay in one run of bytes."""
    small = encode_bank(make_bank(1000, [np.zeros((20, 1))]), 1)
    store = BankStore(3 * len(small), 1000, 1)
    for size, may_forget in steps:
        data = encode_bank(make_bank(1000, [np.zeros((4 * size + 2, 1))]), 1)
        begin, *rest = transfer_messages(data)
        assert isinstance(begin, BankBegin)
        before = (store.held_hash, store._held_at, store._held_size)
        result = store.begin(begin, may_forget)
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
        assert store.held_hash == hash_of_bank(data)
