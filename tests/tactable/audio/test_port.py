"""A sound card behind the commands: the simulated one, fed by its process, and texts that are refused."""

import json
import socket
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from firmware_link.host.link import Link
from firmware_link.host.link_values import LinkConfiguration, LinkState
from firmware_link.host.serial_port import DescriptorPort, ReopeningPort
from firmware_link.host.session import Session
from firmware_link.protocol.drive_words import ChannelDrive, encode_drive
from tactable.audio.board import AudioBoard
from tactable.audio.interfaces import Interface, find_interfaces, select_interface
from tactable.audio.names import AudioError, parse_output
from tactable.audio.port import CARD_BIT_RATE_HZ, CardReopening, Feeder
from tactable.audio.simulated_card import SimulatedCard
from tactable.audio.streams import wait_while_called
from tactable.measure.audio_process import AudioSensor
from tactable.measure.sensor import SensorError
from tests.engine.loop.rig import DEVICE, Rig, held, recording_of, report
from tests.tactable.audio.cards import OUTPUT, TEXT, core
from tests.tactable.cli.in_process import run_here
from tests.tools.virtual import MS, VirtualClock, VirtualLine

DRIVE = ("--frequency", "150,130", "--amplitude", "20 %,5 %", "--for", "0.2 s")


@pytest.mark.machine
def test_a_drive_by_hand_is_played_by_the_process_of_a_card_and_an_absent_card_named(tmp_path: Path) -> None:
    core()
    done = run_here(tmp_path, "play", "reference-a", "--port", TEXT.replace("0.52", "0.7"), *DRIVE, "--json")
    assert done.returncode == 0, done.stderr
    assert "sound card simulated (SIMULATED): 48 kHz" in done.stderr
    assert "a sound card has no firmware" in done.stderr
    assert json.loads(done.stdout)["duration_s"] >= 0.2
    with pytest.raises((SensorError, AudioError), match=r"no sound card|sound cards need"):
        AudioSensor("audio:no such card,scale=9.81 m/s^2", DEVICE)


@pytest.mark.parametrize("channels", ["1+2", "4+3+2+1", "2+3+4+5+6+7+8+9"])
def test_a_card_is_greeted_and_armed_like_a_board_and_latches_when_its_host_lets_go(channels: str) -> None:
    output = parse_output(f"{TEXT},channels={channels}")
    actuators = len(output.channels)
    clock, block_ns = VirtualClock(), round(1e9 * output.block / output.rate_hz)
    ours, theirs = socket.socketpair()
    board, port = AudioBoard(core(), output, 1), DescriptorPort("card", ours.detach())
    feeder = Feeder(board, output, theirs, clock.now_ns)
    session = Session(Link(LinkConfiguration(actuators, bit_rate_hz=CARD_BIT_RATE_HZ)), port, clock.now_ns)
    out = np.zeros((output.block, max(output.channels) + 1), np.float32)
    greatest = np.zeros(out.shape[1])
    wanted = np.zeros(out.shape[1])
    wanted[list(output.channels)] = np.arange(1, actuators + 1) / 10

    def play_until(is_over: Callable[[], bool], exchange: Callable[[], object] = session.exchange) -> None:
        end_ns = clock.time_ns + 10**10
        while not is_over():
            assert clock.time_ns < end_ns
            clock.advance(clock.time_ns + block_ns)
            feeder.feed(out, output.block, False)
            np.maximum(greatest, abs(out).max(axis=0), out=greatest)
            exchange()

    with theirs:
        session.connect()
        play_until(lambda: session.link.state is LinkState.READY)
        assert session.link.capabilities is not None
        assert session.link.capabilities.full_scales_m == pytest.approx((0.8 * 0.52e-6,) * actuators)
        drive = [ChannelDrive(150, amplitude) for amplitude in wanted[list(output.channels)]]
        session.link.set_drive(encode_drive(drive, 0.01))
        end_ns = clock.time_ns + 10**8
        play_until(lambda: clock.time_ns >= end_ns)
        assert greatest == pytest.approx(0.8 * wanted, rel=0.01)
        port.close()
        play_until(feeder.is_silent.is_set, lambda: None)
    assert not out.any() and feeder.gaps == 0


class UnpluggedCard(SimulatedCard):
    def hang_up(self, now_us: int) -> None:
        self.run_until(now_us)
        self.board.hang_up()


class CardLine(VirtualLine):
    """A simulated card in place of the board; the process that feeds it starts a second before it plays."""

    def start(self, boot_id: int) -> SimulatedCard:
        return UnpluggedCard(core(), OUTPUT, seed=boot_id)

    def starting(self) -> Any:
        due_ns, self.wakes_every_ns = self.time_ns + 1_000 * MS, MS

        def greet() -> VirtualLine:
            assert self.time_ns >= due_ns
            return self.open()

        return SimpleNamespace(path="card", has_answered=lambda: self.time_ns >= due_ns, greet=greet)


def test_a_card_that_was_unplugged_is_waited_for_without_keeping_the_loop_and_plays_on() -> None:
    line = CardLine(loses_power=True)
    reopening = ReopeningPort(CardReopening(line.starting), cast("Any", line))
    frames = [*held(0.0, 2.5, (1, 0.1)), *held(2.5, 8.0, (1, 0.3)), (8.0, report(lifted=[1]))]
    rig = Rig(recording_of(*frames), line, reconnect=True, reopening=cast("Any", reopening))
    line.cable_pulled_ns, line.cable_back_ns = rig.start_ns + 300 * MS, rig.start_ns + 2_500 * MS
    rig.run()
    counters = rig.loop.counters
    assert (counters.losses, counters.reconnects, counters.reports) == (1, 1, len(frames))
    assert [(opened_ns - rig.start_ns) // MS // 100 for opened_ns in line.openings_ns] == [19, 55]
    drive = line.firmware.drive(0, line.device_us(), 48_000)
    assert abs(drive[-48_000:]).max() > 0.1


def test_a_card_that_calls_back_no_more_is_named_and_a_process_that_stood_still_is_not_blamed() -> None:
    blocks = iter([1, 20, 40, 40, 40, 60, *[80] * 6])
    with pytest.raises(AudioError, match=r"USB .*unplug"):
        wait_while_called(lambda _: False, lambda: next(blocks), "USB")
    assert not list(blocks)
    wait_while_called(lambda _: True, lambda: 0, "USB")


def test_a_card_is_opened_again_by_its_whole_name_alone_and_of_two_of_a_name_by_its_direction() -> None:
    """A part of the name may be that of another card, once the one that was meant is gone."""
    cards = tuple(Interface(index, name, 2, 0, 48_000.0, 0.01) for index, name in enumerate(("USB A", "USB A 2")))
    assert select_interface("USB A", cards, is_input=False, is_exact=True) is cards[0]
    with pytest.raises(AudioError, match="'USB A'"):
        select_interface("USB A", cards[1:], is_input=False, is_exact=True)
    cards = (Interface(0, "USB", 2, 0, 48_000.0, 0.01), Interface(1, "USB", 0, 2, 48_000.0, 0.01))
    assert [select_interface("USB", cards, is_input=is_input) for is_input in (False, True)] == list(cards)
    with pytest.raises(AudioError, match="'USB' with inputs"):
        select_interface("USB", cards[:1], is_input=True)


class FakePortAudio:
    """What sounddevice says of three cards; the two of one kind have the numbers that the last start gave them."""

    class PortAudioError(Exception):
        pass

    is_running = True

    def query_devices(self) -> list[dict[str, object]]:
        if not self.is_running:
            raise self.PortAudioError("not initialised")
        low = {"default_low_output_latency": 0.0087, "default_samplerate": 44_100.0}
        names = ("USB: (hw:1,0)", "USB: (hw:3,0)", "Other: (hw:2,1)", "default")
        return [{"name": name, "max_output_channels": 4, "max_input_channels": 2, **low} for name in names]


def test_cards_are_found_by_their_name_or_a_part_of_it(tmp_path: Path) -> None:
    """Of two cards of a kind by ALSA's id, since their numbers change places at a start."""
    for number, card_id in ((1, "Device"), (3, "Device_1")):
        (tmp_path / f"card{number}").mkdir()
        (tmp_path / f"card{number}" / "id").write_text(f"{card_id}\n", encoding="utf-8")
    system = FakePortAudio()
    cards = find_interfaces(system, tmp_path)  # type: ignore[arg-type]
    assert [card.name for card in cards] == ["USB: (hw:Device,0)", "USB: (hw:Device_1,0)", "Other: (hw:2,1)", "default"]
    assert (cards[0].outputs, cards[0].inputs) == (4, 2)
    assert select_interface("hw:Device_1,0", cards, is_input=False) is cards[1]
    assert select_interface("other", cards, is_input=False) is cards[2]
    with pytest.raises(AudioError, match=r"is the name of several: .*Device,0.*Device_1,0"):
        select_interface("usb", cards, is_input=False)
    with pytest.raises(AudioError, match=r"no sound card 'hw:1,0' .*hw:Device,0"):
        select_interface("hw:1,0", cards, is_input=False)
    system.is_running = False
    with pytest.raises(AudioError, match="not initialised"):
        find_interfaces(system)  # type: ignore[arg-type]
    with pytest.raises(AudioError, match="scale is missing"):  # before anything starts
        AudioSensor("audio:card", DEVICE)
