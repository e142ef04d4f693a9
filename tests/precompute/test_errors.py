"""Every error of precompute belongs to the one family that the command line reports in a line."""

import importlib
import pkgutil

import precompute
from base.errors import TactableError


def test_every_error_is_a_tactable_error() -> None:
    modules = pkgutil.walk_packages(precompute.__path__, "precompute.")
    members = [member for module in modules for member in vars(importlib.import_module(module.name)).values()]
    errors = {each for each in members if isinstance(each, type) and issubclass(each, Exception)}
    own = {error for error in errors if error.__module__.startswith("precompute.")}
    assert {"ProgramError", "WorkerError", "MeasurementError", "FleetError"} <= {error.__name__ for error in own}
    assert [error for error in own if not issubclass(error, TactableError)] == []
