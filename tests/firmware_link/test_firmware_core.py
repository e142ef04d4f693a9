"""Laws of the C core: those of every device, and that it does what its Python twin does."""

import pytest

from tests.firmware_link.compiled_core import CompiledTier
from tests.firmware_link.conformance import HANG_UP_LAWS, LAWS, WAVE_LAWS, HangUpLaw, Law, WaveLaw


@pytest.mark.parametrize("law", [*LAWS, *WAVE_LAWS, *HANG_UP_LAWS], ids=lambda law: law.__name__)
def test_the_c_core_keeps(law: Law | WaveLaw | HangUpLaw) -> None:
    law(CompiledTier())
