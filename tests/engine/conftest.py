"""Tests of the loop hold with the fast path and without: a module asks for both with RUNS_BOTH_WAYS."""

import pytest


@pytest.fixture
def way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """How the rigs of a test go."""
    from tests.engine.loop.rig import Rig

    if request.param == "fast path":
        monkeypatch.setattr(Rig, "library", request.getfixturevalue("fast_library"))
    return str(request.param)


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Both ways for the modules that ask for them."""
    if getattr(metafunc.module, "RUNS_BOTH_WAYS", False):
        metafunc.fixturenames.append("way")
        metafunc.parametrize("way", ["loop", "fast path"], indirect=True)
