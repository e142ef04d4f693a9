"""Laws of the C core: those of every device, and that it does what its Python twin does."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from firmware_link.protocol.framing import EMERGENCY_STOP
from tests.firmware_link.conformance import (
    HANG_UP_LAWS,
    LAWS,
    LOUD,
    RAMP_US,
    WAVE_LAWS,
    HangUpLaw,
    Host,
    Law,
    WaveLaw,
)
from tests.firmware_link.firmware.compiled_core import (
    LIBRARY,
    CompiledTier,
    WatchedTier,
    make,
    need,
    with_sanitizers,
)
from tests.firmware_link.sensing_laws import SENSING_LAWS

ROOT = Path(__file__).parents[3]


@pytest.mark.parametrize("law", [*LAWS, *WAVE_LAWS, *HANG_UP_LAWS, *SENSING_LAWS], ids=lambda law: law.__name__)
def test_the_c_core_keeps(law: Law | WaveLaw | HangUpLaw) -> None:
    law(WatchedTier())


@pytest.mark.machine
@pytest.mark.parametrize(
    "files",
    ["test_core.py", "test_*.py"],
    ids=["by the laws", "at all"],
)
def test_the_c_core_does_nothing_undefined(tmp_path: Path, files: str) -> None:
    need("make", "cc")
    make(tmp_path, "host", "SANITIZE=address,undefined")
    tests = [str(path) for path in sorted(Path(__file__).parent.glob(files))]
    options = ["-n", "0", "-p", "no:cacheprovider", "-k", "not undefined and not tone"]
    command = [sys.executable, "-m", "pytest", *options, *tests]
    done = subprocess.run(command, cwd=ROOT, env=with_sanitizers(tmp_path), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-4_000:] + done.stderr[-4_000:]
    assert " passed" in done.stdout


@pytest.mark.machine
def test_with_room_for_its_actuators_only_the_c_core_stays_within_its_arrays(tmp_path: Path) -> None:
    """As a board builds it; elsewhere there is room for 255, which hides an index that is one too great."""
    need("make", "cc")
    # Without a runtime: what is out of bounds ends the process.
    make(tmp_path, "host", "ACTUATORS=2", "SANITIZE=undefined -fsanitize-undefined-trap-on-error")
    environment = os.environ | {"TACTABLE_CORE_LIBRARY": str(tmp_path / LIBRARY)}
    command = [sys.executable, "-m", "pytest", "-n", "0", "-p", "no:cacheprovider", __file__, "-k", "keeps or voltage"]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-4_000:] + done.stderr[-4_000:]
    assert "[100%]" in done.stdout


def test_high_voltage_is_allowed_while_armed_and_until_what_sounds_has_faded() -> None:
    """Cut off at once, the actuators would jump; kept on, a bar that nothing drives would stay live."""
    tier = CompiledTier()

    assert not tier.line.firmware.allows_high_voltage
    host = Host(tier).ready()
    assert tier.line.firmware.allows_high_voltage
    host.set(host.drive(*LOUD))
    tier.wait(RAMP_US)
    tier.write(EMERGENCY_STOP)
    tier.wait(RAMP_US // 2)
    assert tier.line.firmware.allows_high_voltage
    tier.wait(RAMP_US)
    assert not tier.line.firmware.allows_high_voltage
