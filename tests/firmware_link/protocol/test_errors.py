"""The families of errors."""

from base.errors import TactableError
from firmware_link.emulator.fault_plan import FaultPlanError
from firmware_link.protocol.errors import LinkError, LinkLostError, MessageError


def test_every_error_of_the_link_is_a_tactable_error() -> None:
    for error in (LinkError, LinkLostError, MessageError, FaultPlanError):
        assert issubclass(error, TactableError)
