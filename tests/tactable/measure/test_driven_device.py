"""The law of a device that is driven by hand: held while the program waits, silent in every other case."""

from dataclasses import replace

import numpy as np
import pytest

from engine.device import Device
from engine.render.board_fit import RendererError
from engine.render.limits import LimitError
from firmware_link.emulator.device_state import DeviceConfiguration
from firmware_link.emulator.drive_log import Cause, ChannelTarget, DriveEvent
from firmware_link.emulator.firmware import EmulatedFirmware
from firmware_link.protocol.link_errors import LinkError
from firmware_link.protocol.messages import DeviceState
from tactable.measure import simulated_bench
from tactable.measure.driven_device import AskedDrive, DrivenDevice, check_drive, simulate_levels
from tactable.rig.simulated_surface import SimulatedSurface
from tests.engine.loop.rig import DEVICE
from tests.tools.virtual import MS, VirtualLine

FIFTH = AskedDrive((150.0, 130.0), (0.2, 0.05), (0.0, 1.0))
MOST = (0.2, 0.2)


def held_for(line: VirtualLine, duration_ns: int, most: tuple[float, float] = MOST) -> None:
    with DrivenDevice(DEVICE, line, line, most) as driven:
        driven.play(check_drive(FIFTH, DEVICE))
        driven.wait(line.now_ns() + duration_ns)


def test_a_drive_is_held_as_asked_and_ends_in_silence() -> None:
    line = VirtualLine()
    held_for(line, 2_000 * MS)
    played, stopped = line.firmware.drive_log
    assert played.cause is Cause.SET
    asked = zip(FIFTH.frequencies_hz, FIFTH.amplitudes, FIFTH.phases_rad, strict=True)
    for channel, (hz, amplitude, phase_rad) in zip(played.channels, asked, strict=True):
        assert channel.frequency_hz == pytest.approx(hz)
        assert channel.amplitude == pytest.approx(amplitude, abs=1e-5)
        assert channel.phase_rad == pytest.approx(phase_rad, abs=1e-4)
    assert stopped.cause is Cause.STOP
    assert stopped.device_time_us - played.device_time_us == pytest.approx(2_000_000, abs=5_000)
    assert line.firmware.state is DeviceState.LATCHED
    assert line.firmware.counters.trips == 0


@pytest.mark.parametrize(
    ("most", "full_scale_pm"),
    [((0.1, 0.1), 520_000), (MOST, 2 * 520_000)],
    ids=["armed for less", "of another full scale"],
)
def test_the_board_plays_no_more_than_it_was_armed_for_and_as_much_displacement_as_was_asked_for(
    most: tuple[float, float], full_scale_pm: int
) -> None:
    line = VirtualLine(DeviceConfiguration(0, full_scales_pm=(full_scale_pm, 520_000)))
    held_for(line, 100 * MS, most=most)
    amplitudes = [channel.amplitude for channel in line.firmware.drive_log[0].channels]
    assert amplitudes == pytest.approx([0.1, 0.05], abs=1e-5)


def test_a_frequency_beside_the_sweep_that_the_board_does_not_play_is_refused() -> None:
    """The board's 655 Hz are enough for the sweep of this device, and less than its actuators' bands."""
    text = DEVICE.text.replace('"300 Hz"]', '"900 Hz"]')
    wide = Device.parse(text, "wide")
    asked = replace(FIFTH, frequencies_hz=(150.0, 700.0))
    line = VirtualLine()
    refused = pytest.raises(RendererError, match=r"700-700 Hz; the connected device plays 1-655\.35 Hz")
    with refused, DrivenDevice(wide, line, line, MOST) as driven:
        driven.play(check_drive(asked, wide))
    assert line.firmware.drive_log == []


def test_an_error_of_the_program_silences_too() -> None:
    line = VirtualLine()
    with pytest.raises(ZeroDivisionError), DrivenDevice(DEVICE, line, line, MOST) as driven:
        driven.play(check_drive(FIFTH, DEVICE))
        driven.wait(line.now_ns() + 100 * MS)
        raise ZeroDivisionError
    assert line.firmware.drive_log[-1].cause is Cause.STOP


def test_a_board_that_stops_itself_ends_the_wait_and_can_be_armed_again() -> None:
    line = VirtualLine()
    with DrivenDevice(DEVICE, line, line, MOST) as driven:
        driven.play(check_drive(FIFTH, DEVICE))
        driven.wait(line.now_ns() + 100 * MS)
        line.stall_at_ns = line.now_ns()
        with pytest.raises(LinkError, match="stopped itself"):
            driven.wait(line.now_ns() + 2_000 * MS)
        assert line.firmware.drive_log[-1].channels[0].amplitude == 0
        driven.arm_again()
        driven.play(check_drive(FIFTH, DEVICE))
        driven.wait(line.now_ns() + 100 * MS)
        assert line.firmware.state is DeviceState.DRIVING


def test_a_lease_that_ended_before_its_renewal_came_is_known_when_it_is_asked_for() -> None:
    line = simulated_bench.VirtualLine(EmulatedFirmware(DeviceConfiguration(0x5EED)))
    with DrivenDevice(DEVICE, line, line, MOST) as driven:
        driven.play(check_drive(FIFTH, DEVICE))
        driven.wait(line.now_ns() + 500 * MS)
        assert driven.confirm_lapses() == 0
        line.run_to(line.now_ns() + 60 * MS)
        assert driven.lapses == 0
        assert driven.confirm_lapses() == 1


@pytest.mark.parametrize(
    ("asked", "text"),
    [
        (replace(FIFTH, amplitudes=(0.2, 1.2)), r"actuator right: an amplitude of 120 % .* ask for 0 to 100 %"),
        (replace(FIFTH, frequencies_hz=(150.0, 301.0)), r"actuator right: 301 Hz .* ask for 60 to 300 Hz"),
    ],
)
def test_what_is_beyond_a_limit_is_refused_by_name(asked: AskedDrive, text: str) -> None:
    with pytest.raises(LimitError, match=text):
        check_drive(asked, DEVICE)


@pytest.mark.parametrize("hz", [(150.0, 150.0), (150.0, 130.0)])
def test_the_levels_are_those_of_the_bar_in_time(hz: tuple[float, float]) -> None:
    asked = AskedDrive(hz, (0.2, 0.1), (0.0, 1.0))
    channels = tuple(ChannelTarget(*each) for each in zip(hz, asked.amplitudes, asked.phases_rad, strict=True))
    bar = SimulatedSurface(DEVICE)
    in_time = bar.simulate_held(DriveEvent(0, Cause.SET, 1, 200.0, channels), ())
    peak_m_per_s2, level_db = simulate_levels(DEVICE, asked, bar.point_m)
    assert peak_m_per_s2 == pytest.approx(in_time.acceleration, rel=0.02)
    # Tones of two frequencies add as powers, so that their level is less than that of the sum of their peaks.
    highest_db = 20 * np.log10(peak_m_per_s2 / DEVICE.threshold.peak_m_per_s2(np.array(hz[:1])))
    assert (level_db == pytest.approx(highest_db)) == (hz[0] == hz[1])
    assert (level_db <= highest_db + 1e-9).all()
