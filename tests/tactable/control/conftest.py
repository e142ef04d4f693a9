"""A control server, and the slot to the loop that takes each part at once."""

import pytest

from tactable.control.control_server import ControlServer
from tests.tactable.control.virtual import VirtualSlot, server_of


@pytest.fixture
def slot() -> VirtualSlot:
    return VirtualSlot(polls=True)


@pytest.fixture
def server(slot: VirtualSlot) -> ControlServer:
    return server_of(slot)
