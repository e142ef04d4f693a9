"""Measuring by a sound card: the response of the bar through card, plant and converter, and the faults of the card."""

import os
from pathlib import Path

import numpy as np
import pytest

from tactable.audio.names import parse_input, parse_output
from tactable.audio.simulated_card import CardFlaws, SimulatedCard
from tactable.measure.apparatus import ApparatusOptions, open_apparatus
from tactable.measure.audio_process import Taker
from tactable.measure.faults import Fault
from tactable.measure.sensor import SampleStream
from tactable.measure.simulated_bench import ConverterFlaws, SimulatedBench
from tactable.measure.stepped_sine import Reading, SteppedSineOptions
from tests.engine.loop.rig import DEVICE
from tests.tactable.audio.cards import core
from tests.tactable.measure.test_stepped_sine import MASS_KG, PLACE_M, errors, stepping
from tests.tools.guard import allowed

PORT = "audio:simulated,full_scale=0.6 um,most=90 %"
SENSOR = "audio:simulated,scale=98.1 m/s^2,loopback=2"
NEAR = np.array([0.05, 0.5])
"""Errors of a response, in dB and degrees."""
ACTUATORS = [actuator.name for actuator in DEVICE.actuators]


def bench_of(card: CardFlaws, flaws: str = "") -> SimulatedBench:
    """A card that drives, and another converter whose one loopback channel has both outputs."""
    made = SimulatedCard(core(), parse_output(PORT), card)
    bench = SimulatedBench(DEVICE, ConverterFlaws.parse(flaws), 1, MASS_KG, card=made, has_sum=True)
    bench.place(PLACE_M)
    return bench


def read(bench: SimulatedBench, actuator: int, hz: float) -> tuple[Reading, float | None]:
    with stepping(bench, SteppedSineOptions(attempts=2)) as stepped:
        latency_s = stepped.measure_latency()
        return stepped.read(actuator, hz)[0], latency_s


def test_two_starts_with_other_latencies_give_the_same_response() -> None:
    starts = [
        read(bench_of(CardFlaws(latency_s=out_s), f"latency={in_ms}ms"), 1, 209)
        for out_s, in_ms in ((0.006, 5), (0.012, 9))
    ]
    latencies_s = [latency_s for _, latency_s in starts if latency_s is not None]
    assert latencies_s[1] - latencies_s[0] == pytest.approx(0.010, abs=0.006)  # a block is 5 ms
    for reading, _ in starts:
        assert all(errors(reading) < NEAR)


def test_gaps_of_the_card_are_named_by_the_reading_that_they_spoil() -> None:
    faults = []
    for card in (CardFlaws(gaps_per_s=5), CardFlaws()):
        bench = bench_of(card)
        reading, _ = read(bench, 0, 209)
        assert bench.card is not None
        assert (bench.card.gaps > 0) == (card.gaps_per_s > 0)
        faults.append({*reading.faults, *reading.earlier})
    assert faults[0] & {Fault.NOISE, Fault.NOT_STEADY, Fault.LOST_SAMPLES}
    assert not faults[1]


def test_nothing_is_driven_above_the_limit_of_the_card() -> None:
    bench = bench_of(CardFlaws(), "noise=3m/s^2")
    reading, _ = read(bench, 0, 170)
    assert reading.amplitude > 0.1  # the level has risen
    assert bench.card is not None
    assert abs(bench.card.drive(0, bench.now_ns() / 1e3, 48_000)).max() <= np.float32(0.9)


def test_one_simulated_card_for_both_is_a_bench() -> None:
    core()
    options = ApparatusOptions(PORT, SENSOR, 0.5, sensor_mass_kg=MASS_KG)
    with allowed("compiles the card's core"), open_apparatus(DEVICE, options, print) as apparatus:
        form = apparatus.sensor.form
        assert (form.sample_rate_hz, form.channels) == (48_000.0, ("acceleration", "loopback left", "loopback right"))
        apparatus.guide(PLACE_M)
        with apparatus.open_driven() as driven:
            assert driven.is_simulated
            assert driven.capabilities.full_scales_m[0] == pytest.approx(0.54e-6)


def stream_of(blocks: list[tuple[np.ndarray[tuple[int, int], np.dtype[np.float32]], bool]]) -> SampleStream:
    """What the sensor reads of blocks (sample, channel) that the callback took, with whether some were lost before."""
    reader, writer = os.pipe()
    taker = Taker(parse_input("audio:card,acceleration=2,scale=50 m/s^2,loopback=1", ACTUATORS), ACTUATORS, writer)
    for data, overflowed in blocks:
        taker.take_block(data, len(data), overflowed)
    os.close(writer)
    stream = SampleStream(Path(f"/proc/self/fd/{reader}"), DEVICE)
    os.close(reader)
    return stream


def test_samples_of_a_card_come_in_the_units_of_the_form_and_losses_are_marked() -> None:
    data = np.array([[0.5, 0.1], [0.25, -0.2]], np.float32)
    stream = stream_of([(data, False), (data, True)])
    assert stream.form.clips_at == pytest.approx((50.0, 1.0, 1.0))
    block = stream.read()
    assert block is not None
    lost = [bool(np.isnan(row).all()) for row in block.values]
    assert lost[:2] == lost[-2:] == [False, False]
    assert all(lost[2:-2])
    assert len(lost) > 4
    assert block.values[0] == pytest.approx([5.0, 0.5, 0.5])  # the one loopback is that of both actuators
    stream.close()


def test_a_card_that_nobody_reads_loses_whole_blocks_and_says_so() -> None:
    reader, writer = os.pipe()
    taker = Taker(parse_input("audio:card,scale=50 m/s^2", ACTUATORS), ACTUATORS, writer)
    for _ in range(400):
        taker.take_block(np.zeros((4_800, 1), np.float32), 4_800, False)
    stream = SampleStream(Path(f"/proc/self/fd/{reader}"), DEVICE)
    first = stream.read()
    taker.take_block(np.ones((4_800, 1), np.float32), 4_800, False)
    taker.take_block(np.ones((4_800, 1), np.float32), 4_800, False)
    second = stream.read()
    assert first is not None
    assert second is not None
    assert not np.isnan(first.values).any()
    assert np.isnan(second.values).sum() == 1
    for descriptor in (reader, writer):
        os.close(descriptor)
    stream.close()
