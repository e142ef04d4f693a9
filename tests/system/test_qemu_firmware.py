"""The laws of every device and the fall to silence, kept by the real images in QEMU, in real time."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from firmware_link.serial_port import SerialPort
from tests.firmware_link.compiled_core import make, need
from tests.firmware_link.conformance import LAWS, Law
from tests.system.firmware_image import FirmwareImage, ImageTier, run_image

pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(
        not os.environ.get("TACTABLE_SYSTEM"),
        reason="TACTABLE_SYSTEM is not set: run tests/system/prepare.sh, set it to 1",
    ),
]
MACHINES = {"mps2_an385": "mps2-an385", "stm32f405_qemu": "netduinoplus2"}


@pytest.fixture(scope="module")
def images(tmp_path_factory: pytest.TempPathFactory) -> Path:
    need("make", "arm-none-eabi-gcc", "qemu-system-arm")
    folder = tmp_path_factory.mktemp("images")
    make(folder)
    return folder


@pytest.fixture(scope="module", params=MACHINES)
def image(images: Path, request: pytest.FixtureRequest) -> Iterator[FirmwareImage]:
    with run_image(images / f"{request.param}.elf", MACHINES[request.param]) as running:
        yield running


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.__name__)
def test_the_image_keeps(law: Law, image: FirmwareImage) -> None:
    with SerialPort(image.port) as port:
        law(ImageTier(image, port))
