"""The laws of every device and the fall to silence, kept by the real images in QEMU, in real time."""

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from firmware_link.host.serial_port import SerialPort
from firmware_link.protocol.messages import ACCELEROMETER, DeviceState
from tests.firmware_link.conformance import DISARM_US, LAWS, LOUD, Host, Law
from tests.firmware_link.driving_host import DRIVING, ENDED, LEASE_MS, SLEW_PER_S
from tests.firmware_link.firmware.compiled_core import make, need
from tests.firmware_link.sensing_laws import (
    SENSING_LAWS,
    SensingLaw,
    sensing_law_no_lease_is_longer_than_the_longest,
)
from tests.system.firmware_image import BEFORE_OTHERS, REPORT_PERIOD_US, FirmwareImage, ImageTier, run_image

pytestmark = pytest.mark.machine
ROOT = Path(__file__).parents[2]
LEASE_US = 1_000 * LEASE_MS
RAMP_US = 1_000_000 // SLEW_PER_S
AFTERWARDS_US = 200_000
ATTEMPTS = 10
MACHINES = {"mps2_an385": "mps2-an385", "stm32f405_qemu": "netduinoplus2"}


@pytest.fixture(scope="module")
def images(tmp_path_factory: pytest.TempPathFactory) -> Path:
    need("make", "arm-none-eabi-gcc", "qemu-system-arm")
    folder = tmp_path_factory.mktemp("images")
    make(folder)
    return folder


@pytest.fixture(scope="module", params=MACHINES)
def image(images: Path, request: pytest.FixtureRequest) -> Iterator[FirmwareImage]:
    with run_image(images / f"{request.param}.elf", MACHINES[request.param], is_stepped=True) as running:
        yield running


@pytest.fixture
def image_in_real_time(images: Path) -> Iterator[FirmwareImage]:
    with run_image(images / "mps2_an385.elf", MACHINES["mps2_an385"]) as running:
        yield running


@contextlib.contextmanager
def driving_host(image: FirmwareImage, how: str) -> Iterator["subprocess.Popen[str]"]:
    """A host that drives. One whose machine stalls for too long before that is rightly stopped: both start anew."""
    command = [*BEFORE_OTHERS, sys.executable, "-m", "tests.firmware_link.driving_host", image.port, how]
    pipe = subprocess.PIPE
    for _ in range(ATTEMPTS):
        with subprocess.Popen(command, cwd=ROOT, stdin=pipe, stdout=pipe, text=True) as process:
            try:
                assert process.stdout is not None
                said = process.stdout.readline().strip()
                if said == DRIVING:
                    yield process
                    return
            finally:
                process.kill()
        boots = image.boots
        image.press_reset()
        image.wait_for_boot(boots)
    pytest.fail(f"the host never drove: {said}")


def kill(process: "subprocess.Popen[str]") -> None:
    process.kill()


def stop(process: "subprocess.Popen[str]") -> None:
    os.kill(process.pid, signal.SIGSTOP)


def tell(process: "subprocess.Popen[str]") -> None:
    assert process.stdin is not None
    with contextlib.suppress(BrokenPipeError):  # it stalled and has ended by itself, which is a failure too
        process.stdin.write("\n")
        process.stdin.flush()


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.__name__)
def test_the_image_keeps(law: Law, image: FirmwareImage) -> None:
    with SerialPort(image.port) as port:
        law(ImageTier(image, port))


# Two seconds of the stream are minutes of a stepped image; the same C core keeps that law in test_core.
BRIEF_LAWS = [law for law in SENSING_LAWS if law is not sensing_law_no_lease_is_longer_than_the_longest]


@pytest.mark.parametrize("law", BRIEF_LAWS, ids=lambda law: law.__name__)
def test_the_image_with_an_accelerometer_keeps(law: SensingLaw, images: Path) -> None:
    with (
        run_image(images / "mps2_an385.elf", MACHINES["mps2_an385"], is_stepped=True) as image,
        SerialPort(image.port) as port,
    ):
        law(ImageTier(image, port))


def test_an_image_whose_part_does_not_answer_has_no_accelerometer(images: Path) -> None:
    """QEMU has the bus of this board and no part on it."""
    with (
        run_image(images / "stm32f405_qemu.elf", MACHINES["stm32f405_qemu"], is_stepped=True) as image,
        SerialPort(image.port) as port,
    ):
        assert ACCELEROMETER not in Host(ImageTier(image, port)).greet().features


@pytest.mark.parametrize(("how", "blow"), [("killed", kill), ("stopped", stop), ("wedged", tell), ("loop", tell)])
def test_a_host_that_fails_leaves_no_drive(
    how: str,
    blow: Callable[["subprocess.Popen[str]"], None],
    image_in_real_time: FirmwareImage,
    capsys: pytest.CaptureFixture[str],
) -> None:
    image = image_in_real_time
    with driving_host(image, how) as process:
        image.wait_for(lambda report: report.state is DeviceState.DRIVING and max(report.peaks) > 0.9)
        blow(process)
        latched = image.wait_for(lambda report: report.state is DeviceState.LATCHED)
        image.wait(AFTERWARDS_US)
        silent_us = max(report.device_us for report in image.reports() if any(report.peaks))
        later = [report for report in image.reports() if report.device_us > latched.device_us]
    assert silent_us - latched.renewed_us <= LEASE_US + RAMP_US + 2 * REPORT_PERIOD_US
    assert DISARM_US <= latched.device_us - latched.renewed_us <= DISARM_US + 2 * REPORT_PERIOD_US
    assert {(report.state, report.has_high_voltage) for report in later} == {(DeviceState.LATCHED, False)}
    with capsys.disabled():
        silent_ms, latched_ms = ((us - latched.renewed_us) / 1e3 for us in (silent_us, latched.device_us))
        print(f"\n  host {how}: silent {silent_ms:.1f} ms after the last frame, latched {latched_ms:.1f} ms")  # noqa: T201


def test_a_reset_in_mid_session_is_not_driven_on(image_in_real_time: FirmwareImage) -> None:
    image = image_in_real_time
    with driving_host(image, "") as process:
        image.wait_for(lambda report: max(report.peaks) > 0.9)
        boots = image.boots
        image.press_reset()
        image.wait_for_boot(boots)
        assert process.stdout is not None
        assert process.stdout.readline().startswith(ENDED)
        image.wait(AFTERWARDS_US)
        assert {(report.state, max(report.peaks)) for report in image.reports()} == {(DeviceState.IDLE, 0.0)}


@pytest.mark.parametrize("damage", [b"w", b"s"], ids=["main loop wedged", "samples stopped"])
def test_the_watchdog_resets_a_board_of_which_half_stands_still(damage: bytes, images: Path) -> None:
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
    assert told == {(DeviceState.IDLE, False, 0.0)}
