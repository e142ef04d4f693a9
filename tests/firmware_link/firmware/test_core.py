"""Laws of the C core: those of every device, and that it does what its Python twin does."""

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from firmware_link.protocol.framing import EMERGENCY_STOP
from firmware_link.protocol.messages import MAXIMUM_ACTUATORS
from tests.firmware_link.firmware.compiled_core import CompiledTier, need, with_sanitizers
from tests.firmware_link.firmware.twins import make_sanitized, run_apart
from tests.firmware_link.law_host import LOUD, RAMP_US, Host, Law, WaveLaw
from tests.firmware_link.sensing_laws import SENSING_LAWS
from tests.firmware_link.test_conformance import LAWS, WAVE_LAWS

ROOT = Path(__file__).parents[3]
FRAMES = int(os.environ.get("TACTABLE_FUZZ_SESSIONS", "20000"))


@pytest.fixture(scope="module")
def sanitized(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a core that stops at what is undefined.

    It has room for its actuators only, as a board builds it: room for 255 hides an index that is one too great.
    """
    need("make", "cc")
    folder = tmp_path_factory.mktemp("sanitized")
    make_sanitized(folder)
    return folder


@pytest.mark.parametrize("law", [*LAWS, *WAVE_LAWS, *SENSING_LAWS], ids=lambda law: law.__name__)
def test_the_c_core_keeps(law: Law | WaveLaw) -> None:
    law(CompiledTier())


@pytest.mark.long
@pytest.mark.parametrize("actuators", [8, MAXIMUM_ACTUATORS])
def test_the_c_core_with_more_actuators_keeps_all_laws(actuators: int) -> None:
    for law in (*LAWS, *WAVE_LAWS, *(SENSING_LAWS if actuators < MAXIMUM_ACTUATORS else ())):
        law(CompiledTier(actuators))


@pytest.mark.machine(stall_s=None)
def test_the_c_core_does_nothing_undefined_in_its_tests(sanitized: Path) -> None:
    tests = [str(path) for path in sorted(Path(__file__).parent.glob("test_*.py"))]
    # A board of two actuators has no room for the frames of more.
    chosen = "not undefined and not tone and not (longest and (36 or 100 or 255))"
    command = [sys.executable, "-m", "pytest", "-n", "0", "-p", "no:cacheprovider", "-k", chosen, *tests]
    done = subprocess.run(
        command, cwd=ROOT, env=with_sanitizers(sanitized), capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout[-4_000:] + done.stderr[-4_000:]
    assert " passed" in done.stdout


@pytest.mark.machine(stall_s=None)
def test_nothing_undefined_happens_in_random_sessions(sanitized: Path) -> None:
    """Two seeds at once, of half of the frames each; TACTABLE_FUZZ_SESSIONS=1000000 has fifty times as many."""
    with ThreadPoolExecutor(2) as pool:
        for done in pool.map(lambda seed: run_apart(sanitized, ["--seed", seed, "--frames", str(FRAMES // 2)]), "23"):
            assert done.returncode == 0, done.stderr[-6_000:]
            print(done.stdout)  # noqa: T201  # the counts


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
