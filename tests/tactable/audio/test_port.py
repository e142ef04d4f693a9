"""A sound card behind the commands: the simulated one, fed by its process, and texts that are refused."""

import json
import socket
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from firmware_link.host.descriptor_port import DescriptorPort
from firmware_link.host.link import Link
from firmware_link.host.link_values import LinkConfiguration, LinkState
from firmware_link.host.session import Session
from firmware_link.protocol.messages import ChannelDrive, encode_drive
from tactable.audio.board import AudioBoard
from tactable.audio.interfaces import Interface, find_interfaces, select_interface
from tactable.audio.names import AudioError
from tactable.audio.output_process import Feeder
from tactable.audio.port import BIT_RATE_HZ
from tactable.measure.audio_sensor import AudioSensor
from tactable.measure.sensor import SensorError
from tests.engine.loop.rig import DEVICE
from tests.tactable.audio.cards import OUTPUT, TEXT, core
from tests.tactable.cli.in_process import run_here
from tests.tools.virtual import VirtualClock

DRIVE = ("--frequency", "150,130", "--amplitude", "20 %,5 %", "--for", "0.2 s")


@pytest.mark.machine
def test_a_drive_by_hand_is_played_by_the_process_of_a_card_and_a_card_that_is_not_there_is_named(
    tmp_path: Path,
) -> None:
    core()
    done = run_here(tmp_path, "play", "reference-a", "--port", TEXT.replace("0.52", "0.7"), *DRIVE, "--json")
    assert done.returncode == 0, done.stderr
    assert "sound card simulated (SIMULATED): 48 kHz" in done.stderr
    assert "a sound card has no firmware" in done.stderr
    assert json.loads(done.stdout)["duration_s"] >= 0.2
    with pytest.raises((SensorError, AudioError), match=r"no sound card|sound cards need"):
        AudioSensor("audio:no such card,scale=9.81 m/s^2", DEVICE)


def test_a_card_is_greeted_and_armed_like_a_board_and_latches_when_its_host_lets_go() -> None:
    clock, block_ns = VirtualClock(), round(1e9 * OUTPUT.block / OUTPUT.rate_hz)
    ours, theirs = socket.socketpair()
    board, port = AudioBoard(core(), OUTPUT, 1), DescriptorPort("card", ours.detach())
    feeder = Feeder(board, OUTPUT, theirs, clock.now_ns)
    session = Session(Link(LinkConfiguration(2, bit_rate_hz=BIT_RATE_HZ)), port, clock.now_ns)
    out = np.zeros((OUTPUT.block, max(OUTPUT.channels) + 1), np.float32)

    def play_until(is_over: Callable[[], bool], exchange: Callable[[], object] = session.exchange) -> None:
        end_ns = clock.time_ns + 10**10
        while not is_over():
            assert clock.time_ns < end_ns
            clock.advance(clock.time_ns + block_ns)
            feeder.feed(out, OUTPUT.block, False)
            exchange()

    with theirs:
        session.connect()
        play_until(lambda: session.link.state is LinkState.READY)
        assert session.link.capabilities is not None
        assert session.link.capabilities.full_scales_m == pytest.approx((0.8 * 0.52e-6,) * 2)
        session.link.set_drive(encode_drive([ChannelDrive(150, 0.1)] * 2, 0.01))
        play_until(lambda: bool(abs(out).max() > 0.05))
        port.close()
        play_until(feeder.is_silent.is_set, lambda: None)
    assert not out.any() and feeder.gaps == 0


def test_a_sensor_without_a_scale_is_refused_before_anything_starts() -> None:
    with pytest.raises(AudioError, match="scale is missing"):
        AudioSensor("audio:card", DEVICE)


def interface(index: int, name: str) -> Interface:
    return Interface(index, name, 2, 2, 48_000.0, 0.01)


class FakePortAudio:
    """What sounddevice says of one card."""

    @staticmethod
    def query_devices() -> list[dict[str, object]]:
        low = {"default_low_output_latency": 0.0087}
        ends = {"max_output_channels": 4, "max_input_channels": 2}
        return [{"name": "USB: (hw:1,0)", "default_samplerate": 44_100.0, **ends, **low}]


def test_cards_are_found_by_their_name_or_a_part_of_it() -> None:
    (found,) = find_interfaces(FakePortAudio())  # type: ignore[arg-type]
    assert (found.name, found.outputs, found.inputs) == ("USB: (hw:1,0)", 4, 2)
    cards = (found, interface(1, "HDA Intel: ALC (hw:0,0)"), interface(2, "HDA Intel: HDMI (hw:0,3)"))
    assert select_interface("usb", cards) is found
    with pytest.raises(AudioError, match=r"is the name of several: .*ALC.*HDMI"):
        select_interface("HDA", cards)
    with pytest.raises(AudioError, match="those that there are: USB"):
        select_interface("nothing", cards)
