"""The laws of every device and the fall to silence, kept by the real images in QEMU, in real time."""

import contextlib
import os
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

from firmware_link.host.serial_port import SerialPort
from firmware_link.protocol.messages import ACCELEROMETER, DeviceState
from tests.firmware_link import click_laws, drive_laws, sensing_laws
from tests.firmware_link.driving_host import ENDED, LEASE_MS, SLEW_PER_S, Process, host_process, strike
from tests.firmware_link.firmware.compiled_core import make, need
from tests.firmware_link.law_host import DISARM_US, LOUD, Host, Law
from tests.firmware_link.test_conformance import LAWS, keep_each_law
from tests.system.firmware_image import BEFORE_OTHERS, REPORT_PERIOD_US, FirmwareImage, ImageTier, run_image
from tests.tools.once import once_a_run

pytestmark = pytest.mark.machine
LEASE_US = 1_000 * LEASE_MS
RAMP_US = 1_000_000 // SLEW_PER_S
AFTERWARDS_US = 200_000
ATTEMPTS = 10
MAIN_LOOP_WEDGED, SAMPLES_STOPPED = b"w", b"s"
ALL_LAWS = os.environ.get("TACTABLE_IMAGE_LAWS") == "all"
MACHINES = {"mps2_an385": "mps2-an385", "mps2_four": "mps2-an385", "stm32f405_qemu": "netduinoplus2"}


@pytest.fixture(scope="session")
def images(tmp_path_factory: pytest.TempPathFactory) -> Path:
    need("make", "arm-none-eabi-gcc", "qemu-system-arm")
    return once_a_run(tmp_path_factory, "images", lambda folder: make(folder, "-j2"))


def reset(image: FirmwareImage) -> None:
    boots = image.boots
    image.press_reset()
    image.wait_for_boot(boots)


@contextlib.contextmanager
def driving_host(image: FirmwareImage, how: str) -> Iterator[Process]:
    """A host that drives. One whose machine stalls for too long before that is rightly stopped: both start anew."""
    for _ in range(ATTEMPTS):
        with host_process(image.port, how, *BEFORE_OTHERS) as (process, drives):
            if drives:
                yield process
                return
        reset(image)
    pytest.fail("the host never drove")


# What an image alone has: its timers, interrupts, serial line and memory. Every law is kept by the same core in
# tests/firmware_link/firmware/test_core.py.
BRIEF_LAWS = (
    drive_laws.law_nothing_drives_before_it_is_armed,
    drive_laws.law_a_rebooted_device_is_not_driven_by_old_traffic,
    drive_laws.law_the_first_greeting_of_a_boot_is_told,
    drive_laws.law_a_drive_ends_with_its_lease,
    drive_laws.law_a_silent_host_latches_the_device,
    drive_laws.law_eight_zeros_latch,
    drive_laws.law_any_garbage_ends_at_the_next_delimiter,
    drive_laws.law_counters_tell_what_came,
    click_laws.law_a_basis_is_kept_until_the_device_boots,
    click_laws.law_an_armed_device_plays_its_basis_until_the_next_is_whole,
    click_laws.law_a_click_ends_by_itself,
)
BRIEF_SENSING_LAWS = (
    sensing_laws.sensing_law_a_stream_ends_with_its_lease,
    sensing_laws.sensing_law_frames_and_samples_are_numbered_without_a_gap,
)
# Two seconds of the stream are minutes of a stepped image.
SENSING_LAWS = [
    law for law in sensing_laws.SENSING_LAWS if law is not sensing_laws.sensing_law_no_lease_is_longer_than_the_longest
]


def keep_laws(elf: Path, laws: Sequence[Law], sensing: Sequence[Law]) -> None:
    """QEMU has the bus of the STM32F405 and no accelerometer on it; that of the MPS2 is simulated.

    Of four actuators, a stream would take 87 % of the line, more than a host asks for.
    """
    has_sensor = elf.stem != "stm32f405_qemu"
    with (
        run_image(elf, MACHINES[elf.stem], is_stepped=True) as image,
        SerialPort(image.port) as port,
    ):
        keep_each_law([*laws, *(sensing if elf.stem == "mps2_an385" else ())], lambda: ImageTier(image, port))
        hello = Host(ImageTier(image, port)).greet()
        assert (ACCELEROMETER in hello.features) == has_sensor
        assert hello.number_of_actuators == (4 if elf.stem == "mps2_four" else 2)


@pytest.mark.machine(stall_s=0.01)  # bytes are lost where QEMU waits for longer: its terminals hold a few milliseconds
@pytest.mark.parametrize("name", MACHINES)
def test_the_image_keeps_the_laws(name: str, images: Path) -> None:
    keep_laws(images / f"{name}.elf", BRIEF_LAWS, BRIEF_SENSING_LAWS)


@pytest.mark.skipif(not ALL_LAWS, reason="long run: set TACTABLE_IMAGE_LAWS=all (3 minutes)")
def test_the_images_keep_all_laws(images: Path) -> None:
    for name in MACHINES:
        keep_laws(images / f"{name}.elf", LAWS, SENSING_LAWS)


def test_a_failed_host_drives_no_more(images: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with run_image(images / "mps2_an385.elf", MACHINES["mps2_an385"]) as image:
        for how in ("killed", "stopped", "wedged", "loop"):
            with driving_host(image, how) as process:
                image.wait_for(lambda report: report.state is DeviceState.DRIVING and max(report.peaks) > 0.9)
                strike(process, how)
                latched = image.wait_for(lambda report: report.state is DeviceState.LATCHED)
                image.wait(AFTERWARDS_US)
                silent_us = max(report.device_us for report in image.reports() if any(report.peaks))
                later = [report for report in image.reports() if report.device_us > latched.device_us]
            assert silent_us - latched.renewed_us <= LEASE_US + RAMP_US + 2 * REPORT_PERIOD_US, how
            assert DISARM_US <= latched.device_us - latched.renewed_us <= DISARM_US + 2 * REPORT_PERIOD_US, how
            assert {(report.state, report.has_high_voltage) for report in later} == {(DeviceState.LATCHED, False)}, how
            with capsys.disabled():
                silent_ms, latched_ms = ((us - latched.renewed_us) / 1e3 for us in (silent_us, latched.device_us))
                print(f"\n  host {how}: silent {silent_ms:.1f} ms after the last frame, latched {latched_ms:.1f} ms")  # noqa: T201
            reset(image)
        with driving_host(image, "") as process:
            image.wait_for(lambda report: max(report.peaks) > 0.9)
            reset(image)
            assert process.stdout is not None
            assert process.stdout.readline().startswith(ENDED), "a reset in mid-session"
            image.wait(AFTERWARDS_US)
            assert {(report.state, max(report.peaks)) for report in image.reports()} == {(DeviceState.IDLE, 0.0)}


def test_the_watchdog_resets_a_board_of_which_half_stands_still(images: Path) -> None:
    for damage in MAIN_LOOP_WEDGED, SAMPLES_STOPPED:
        with (
            run_image(images / "mps2_an385.elf", MACHINES["mps2_an385"], is_stepped=True) as image,
            SerialPort(image.port) as port,
        ):
            host = Host(ImageTier(image, port)).ready()
            host.set(host.drive(*LOUD))
            boots = image.boots
            assert image.debugger is not None
            image.debugger.detach()
            image.damage(damage)
            image.wait_for_boot(boots)
            image.wait(AFTERWARDS_US)
            told = {(report.state, report.has_high_voltage, max(report.peaks)) for report in image.reports()}
        assert told == {(DeviceState.IDLE, False, 0.0)}, damage
