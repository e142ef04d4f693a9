"""Solvers of drives at positions for the shipped devices and others, with what a test needs beside them."""

from functools import cache

from engine.device import Device
from engine.steady.solver import SteadySolver
from precompute.entries.solver import EntrySolver
from precompute.model.assembly import assemble
from precompute.predict.at_positions import SteadyDesigner
from precompute.sampling.places import solve_place_receptances
from tests.precompute.devices import shipped, three_actuators

DEVICES = {
    "reference-a": shipped("reference-a"),
    "reference-d": shipped("reference-d"),
    "reference-t": shipped("reference-t"),
    "three actuators": three_actuators(),
}


@cache
def designer_of(device: Device) -> SteadyDesigner:
    return SteadyDesigner(device)


@cache
def tabulated(device: Device) -> tuple[EntrySolver, SteadySolver]:
    """The tabulated search of a device, and the solver from receptances at the same frequencies."""
    solver = EntrySolver(assemble(device))
    return solver, SteadySolver(device, solve_place_receptances(solver.plant, solver.frequency_hz))
