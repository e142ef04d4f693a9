"""What every device of this protocol keeps to: it holds a basis, plays its clicks, and makes no step."""

import dataclasses
import math
import zlib
from typing import Any

import numpy as np

from firmware_link.protocol.basis import Basis, BasisSet, encode_basis, transfer_messages
from firmware_link.protocol.drive_words import ChannelDrive
from firmware_link.protocol.messages import (
    BASIS_CHUNK_SIZE,
    MAXIMUM_WEIGHTS,
    BasisBegin,
    BasisChunk,
    BasisCommit,
    DeviceState,
    FaultCode,
    KeepAlive,
    Log,
    LogCode,
    Play,
    Result,
    Stop,
)
from tests.firmware_link.law_host import (
    CLICKS,
    DISARM_US,
    FULL,
    LOG_SPACING_US,
    LOUD,
    RAMP_US,
    ROUNDING,
    SAMPLE_RATE_HZ,
    SLEW_PER_S,
    US_PER_MS,
    US_PER_S,
    WAVEFORM_US,
    Clicks,
    Host,
    Tier,
    WaveTier,
    hump,
    with_basis,
)


def law_a_basis_is_kept_until_the_device_boots(tier: Tier) -> None:
    host = Host(tier)
    assert host.greet().held_basis_hash == 0
    tier.wait(LOG_SPACING_US)
    steps = list(transfer_messages(CLICKS.basis.data))
    for message in steps:
        for _copy in range(2):
            assert host.ask(message) is Result.OK
    assert [m.value for m in host.heard if isinstance(m, Log)][1:] == [CLICKS.basis.hash]
    host.ready()
    host.play(0)
    assert host.ask(Stop()) is Result.OK
    for message in (*steps[:2], steps[-1]):
        assert host.ask(message) is Result.WRONG_STATE
    assert host.greet().held_basis_hash == CLICKS.basis.hash
    tier.reboot()
    assert Host(tier).greet().held_basis_hash == 0


def law_a_basis_whose_checksum_is_0_is_held_as_1(tier: Tier) -> None:
    data = Basis(1_000, (BasisSet(np.array([[0, 13_060, -27_743, 0]], np.int16), np.zeros(1, np.uint8)),)).data
    assert zlib.crc32(data) == 0
    host = Host(tier)
    host.greet()
    assert host.offer(data) is Result.OK
    assert host.greet().held_basis_hash == 1


def law_a_basis_that_is_not_whole_is_refused(tier: Tier) -> None:
    host = Host(tier)
    host.greet()
    data = CLICKS.basis.data
    begin, *chunks, commit = transfer_messages(data)
    assert isinstance(chunks[0], BasisChunk)
    damaged = dataclasses.replace(chunks[0], data=bytes(chunks[0].data[:-1]) + b"\x5a")
    assert host.ask(chunks[0]) is Result.WRONG_STATE
    for start, rest in ((begin, chunks[:-1]), (begin, [damaged, *chunks[1:]]), (BasisBegin(5, len(data)), chunks)):
        for message in (start, *rest):
            assert host.ask(message) is Result.OK
        assert host.ask(commit) is Result.WRONG_HASH
        assert host.ask(commit) is Result.WRONG_STATE
    assert host.ask(begin) is Result.OK
    assert host.ask(chunks[1]) is Result.OUT_OF_RANGE
    assert host.greet().held_basis_hash == 0
    assert host.ask(chunks[0]) is Result.WRONG_STATE


def law_a_basis_that_makes_no_sense_is_refused(tier: Tier) -> None:
    host = Host(tier)
    hello = host.greet()
    data = CLICKS.basis.data
    loud_at_the_end, loud_at_first = data[:-2] + b"\x01\x00", data[:14] + b"\x01" + data[15:]
    no_rate, no_set = b"\0\0" + data[2:], data[:2] + b"\0\0"
    of_no_actuator = data[:12] + bytes([hello.number_of_actuators]) + data[13:]
    no_function, too_many = (encode_basis(unchecked(functions)) for functions in (0, MAXIMUM_WEIGHTS + 1))
    one_more = (data + b"\0\0", data[:-1])
    for nonsense in (loud_at_the_end, loud_at_first, no_rate, no_set, of_no_actuator, no_function, too_many, *one_more):
        assert host.offer(nonsense) is Result.OUT_OF_RANGE
    # The longest is some milliseconds more than 2^32 us.
    for rate_hz, length in ((1_000, hello.longest_waveform_ms + 1), (1, 4_295), (1_000, hello.longest_waveform_ms)):
        silence = BasisSet(np.zeros((1, length + 1), np.int16), np.zeros(1, np.uint8))
        result = host.offer(Basis(rate_hz, (silence,)).data)
        assert result is (Result.OK if length == hello.longest_waveform_ms else Result.OUT_OF_RANGE)


def law_a_transfer_goes_on_whatever_is_refused_meanwhile(tier: Tier) -> None:
    """The third basis fits just before the second, behind which there is no room for what is refused."""
    first, second = (Clicks(SAMPLE_RATE_HZ, [hump(each, each, duration_us=60 * US_PER_MS)]) for each in (0.3, 0.7))
    host = Host(tier)
    capacity = host.greet().basis_capacity_bytes
    for clicks in (first, second):
        assert host.offer(clicks.basis.data) is Result.OK
    assert host.arm() is Result.OK
    data = first.basis.data
    begin, *chunks, commit = transfer_messages(data)
    assert isinstance(chunks[-1], BasisChunk)
    at = chunks[-1].offset_bytes
    chunks[-1] = BasisChunk(at, data[at:].ljust(BASIS_CHUNK_SIZE, b"\xff"))
    for step in (begin, *chunks):
        assert host.ask(step) is Result.OK
        if step is chunks[0]:
            assert host.ask(BasisBegin(7, capacity)) is Result.NO_ROOM
            assert host.ask(BasisBegin(7, capacity + 1)) is Result.NO_ROOM
            assert host.ask(BasisBegin(0, 10)) is Result.OUT_OF_RANGE
            assert host.ask(BasisChunk(1, bytes(BASIS_CHUNK_SIZE))) is Result.OUT_OF_RANGE
    assert host.ask(BasisChunk(len(data), b"\xff" * BASIS_CHUNK_SIZE)) is Result.OUT_OF_RANGE
    for clicks, peak in ((second, 0.7), (first, 0.3)):
        assert abs(host.click(0, clicks=clicks).peaks[0] - peak) < 0.01
        assert host.ask(commit) is Result.OK


def law_an_armed_device_plays_its_basis_until_the_next_is_whole(tier: Tier) -> None:
    host = with_basis(tier)
    # No larger than the first: between the commands there are 250 ms for its transfer on a slow line.
    other = Clicks(SAMPLE_RATE_HZ, [hump(0.2, 0.8, duration_us=2 * WAVEFORM_US)])
    *steps, commit = transfer_messages(other.basis.data)
    half = len(steps) // 2
    for message in steps[:half]:
        assert host.ask(message) is Result.OK
    assert abs(host.click(0, 0.5).peaks[0] - 0.5) < 0.01
    for message in (*steps[half:], commit, commit):
        assert host.ask(message) is Result.OK
    click = host.click(0, clicks=other)
    assert click.duration_us >= 2 * WAVEFORM_US
    assert np.abs(np.subtract(click.peaks[:2], (0.2, 0.8))).max() < 0.01


def law_a_basis_stays_unless_an_idle_device_needs_its_room_for_another(tier: Tier) -> None:
    host = with_basis(tier)
    assert host.hello is not None
    capacity = host.hello.basis_capacity_bytes
    assert host.ask(BasisBegin(5, 100)) is Result.OK
    assert host.ask(BasisCommit(5)) is Result.WRONG_HASH
    rest = capacity - len(CLICKS.basis.data)
    for size, result in ((rest, Result.OK), (rest + 1, Result.NO_ROOM), (capacity, Result.NO_ROOM)):
        assert host.ask(BasisBegin(7, size)) is result
    assert host.greet().held_basis_hash == CLICKS.basis.hash
    assert host.ask(BasisBegin(7, capacity)) is Result.OK
    assert host.greet().held_basis_hash == 0


def law_a_click_ends_by_itself(tier: Tier) -> None:
    host = with_basis(tier)
    click = host.click(0, 0.5)
    assert 0 <= click.duration_us - WAVEFORM_US <= tier.slack_us
    assert click.ended.trips == 0
    assert np.abs(np.subtract(click.peaks[:2], (0.5, 0.25))).max() < 0.01
    host.expect_silence(click.ended.device_time_us + tier.slack_us)


def law_a_click_that_the_basis_does_not_fit_is_refused(tier: Tier) -> None:
    host = with_basis(tier)
    before = host.fresh_status()
    missing = len(CLICKS.weights)
    fitting = CLICKS.play(0, 0)
    one_less = {"number_of_weights": 1, "weights": fitting.weights[:1]}
    # What stands behind the last set reads as one of no functions.
    none = {"basis_set": missing, "number_of_weights": 0, "weights": ()}
    changes: list[dict[str, Any]] = [{"fraction_bits": 0}, {"fraction_bits": 32}, one_less, none, {"basis_set": 255}]
    bad = [CLICKS.play(missing, 0), *(dataclasses.replace(fitting, **change) for change in changes)]
    frames = [host.frame(dataclasses.replace(play, clock_reference=host.clock_reference())) for play in bad]
    tier.write(b"".join(frames))
    refused = host.status(lambda status: status.refused == before.refused + 6)
    assert (refused.applied, refused.state) == (before.applied, DeviceState.ARMED)
    told = [m for m in host.heard if isinstance(m, Log) and m.code is LogCode.PLAY_REFUSED]
    # Others within the spacing are not told.
    assert [log.value for log in told] == [missing] or (tier.slack_us and told)


def law_a_long_click_needs_a_living_host(tier: Tier) -> None:
    clicks = Clicks(SAMPLE_RATE_HZ, [hump(1.0, 1.0, duration_us=400 * US_PER_MS)])
    for is_alive in (True, False):
        host = with_basis(tier, clicks.basis)
        started = host.play(0, clicks=clicks)
        for _ in range(30 * is_alive):
            host.send(KeepAlive(host.clock_reference(), started.applied_sequence))
            tier.wait(20 * US_PER_MS)
        ended = host.status(lambda status: status.state is not DeviceState.DRIVING)
        if is_alive:
            assert ended.device_time_us - started.applied_time_us >= 400 * US_PER_MS
        else:
            assert ended.state is DeviceState.LATCHED
            assert 0 <= ended.device_time_us - started.applied_time_us - DISARM_US <= tier.slack_us
            host.expect_silence(ended.device_time_us + RAMP_US + tier.slack_us)


def unchecked(functions: int) -> Basis:
    """A basis of one set of silent functions, however many."""
    basis = object.__new__(Basis)
    silence = BasisSet(np.zeros((functions, 2), np.int16), np.zeros(functions, np.uint8))
    object.__setattr__(basis, "sample_rate_hz", SAMPLE_RATE_HZ)
    object.__setattr__(basis, "sets", (silence,))
    return basis


def wave_law_takeovers_make_no_step(tier: WaveTier) -> None:
    host = with_basis(tier)
    drive, other = host.drive(*LOUD), host.drive(ChannelDrive(150, 0.7), ChannelDrive(180, 1.0))
    noise = np.random.default_rng(2)
    begun_us = host.device_us()
    for _ in range(40):
        match noise.integers(5):
            case 0:
                host.send(host.set_message(drive))
            case 1:
                host.send(host.set_message(other))
            case 2:
                host.send(host.set_message(bytes(len(drive))))
            case _:
                host.send(CLICKS.play(int(noise.integers(2)), host.clock_reference()))
        tier.wait(int(noise.integers(200, 20 * US_PER_MS)))
    host.pass_until(host.device_us() + 100 * US_PER_MS)
    rate_hz, displacements = tier.outputs(begun_us, host.device_us() - 50 * US_PER_MS)
    assert np.abs(displacements).max() > 0.5
    # A full sine of 200 Hz, the steepest waveform, and the slew of each that fades.
    fastest_per_s = math.tau * 200 + 2 * math.pi * US_PER_S / WAVEFORM_US + 3 * SLEW_PER_S
    assert np.abs(np.diff(displacements, axis=0)).max() <= fastest_per_s / rate_hz + ROUNDING


def wave_law_no_weights_pass_amplitude_or_slew_and_no_sum_the_limit(tier: WaveTier) -> None:
    noise = np.random.default_rng(3)
    functions = noise.integers(-32_767, 32_767, (24, 61), np.int16, endpoint=True)
    functions[:, [0, -1]] = 0
    basis = Basis(SAMPLE_RATE_HZ, (BasisSet(functions, noise.integers(0, 2, 24).astype(np.uint8)),))
    host = with_basis(tier, basis, limit=FULL // 2)
    assert host.hello is not None
    highest_hz = host.hello.frequency_maximum * host.hello.frequency_resolution_uhz * 1e-6

    def play(fraction_bits: int) -> None:
        weights = tuple(noise.integers(-32_768, 32_767, 24, endpoint=True).tolist())
        host.send(Play(host.clock_reference(), 0, fraction_bits, FULL, 24, weights))

    begun_us = host.device_us()
    for fraction_bits in (1, 12, 16, 19, 22):
        play(fraction_bits)
        host.status(lambda status: status.state is DeviceState.DRIVING)
        host.ended()
    tier.wait(US_PER_MS)
    clicked_us = host.device_us()
    for _ in range(10):
        host.set(host.drive(*LOUD))
        for wait_ms in (12, 5):
            tier.wait(wait_ms * US_PER_MS)
            play(19)
        tier.wait(15 * US_PER_MS)
    host.pass_until(host.device_us() + 100 * US_PER_MS)
    assert 0.49 < np.abs(tier.outputs(clicked_us, host.device_us())[1]).max() <= 0.5 + ROUNDING
    rate_hz, displacements = tier.outputs(begun_us, clicked_us)
    assert 0.49 < np.abs(displacements).max() <= 0.5 + ROUNDING
    # A change of one sample of the basis is a straight line, and rounded up to a step of it.
    fastest_per_s = 0.5 * math.tau * highest_hz + SAMPLE_RATE_HZ / 32_767
    assert np.abs(np.diff(displacements, axis=0)).max() <= fastest_per_s / rate_hz + ROUNDING
    assert not displacements[-1].any()


def wave_law_what_every_drive_leaves_quiet_stays_quiet_while_they_follow_each_other(tier: WaveTier) -> None:
    """Half of what the first actuator does and all of the second are 0 together, in every drive and in between."""
    host = Host(tier).ready()
    noise = np.random.default_rng(5)
    begun_us = 0
    for step in range(40):
        frequency_hz = noise.uniform(60, 300) if noise.integers(3) == 0 else 200
        amplitude, turned = noise.uniform(0.1, 1.0), noise.uniform(0, math.tau)
        drive = host.drive(
            ChannelDrive(frequency_hz, amplitude, turned), ChannelDrive(frequency_hz, amplitude / 2, turned + math.pi)
        )
        host.send(host.set_message(drive))
        # A crossfade of these takes up to twice the ramp: some wait for it, and some of those are overtaken.
        tier.wait(int(noise.integers(RAMP_US // 5, 3 * RAMP_US)))
        if step == 0:
            host.pass_until(host.device_us() + RAMP_US)
            begun_us = host.device_us()
    _, displacements = tier.outputs(begun_us, host.device_us())
    assert np.abs(displacements).max() > 0.5
    assert np.abs(displacements[:, :2] @ [0.5, 1.0]).max() <= ROUNDING


def wave_law_a_dropped_line_latches_at_once(tier: WaveTier) -> None:
    host = Host(tier).ready()
    applied = host.set(host.drive(*LOUD))
    tier.hang_up()
    tier.wait(400 * US_PER_MS)
    again = Host(tier)
    again.compare_clocks()
    status = again.fresh_status()
    assert (status.state, status.fault) == (DeviceState.LATCHED, FaultCode.HUNG_UP)
    again.expect_silence(applied.applied_time_us + tier.lease_ms * US_PER_MS + RAMP_US + tier.slack_us)
