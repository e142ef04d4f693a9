"""The conformance suite: one law a function of `drive_laws` and `click_laws`, over any device that a `Tier` reaches.

Times of a law are the device's own, from its STATUS, so that a slow machine or line makes no law fail. Laws of real
time are given slack by the tier.
"""

from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

from tests.firmware_link import click_laws, drive_laws
from tests.firmware_link.law_host import Law, Tier, WaveLaw

T = TypeVar("T", bound=Tier)


def keep_laws(laws: Iterable[Callable[[T], None]], boot: Callable[[], T]) -> None:
    """Each law over a device that has just booted; a failure names its law."""
    for law in laws:
        try:
            law(boot())
        except AssertionError as error:
            error.add_note(f"law: {law.__name__}")
            raise


def _laws(prefix: str) -> Iterator[Callable[..., None]]:
    return (value for name, value in (vars(drive_laws) | vars(click_laws)).items() if name.startswith(prefix))


LAWS: tuple[Law, ...] = tuple(_laws("law_"))
WAVE_LAWS: tuple[WaveLaw, ...] = tuple(_laws("wave_law_"))
