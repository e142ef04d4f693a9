"""Solvers of drives at positions for the shipped devices and others, with what a test needs beside them."""

from dataclasses import replace
from functools import cache

from engine.device import Device
from engine.steady.solver import SteadySolver
from precompute.entries.at_positions import SteadyDesigner
from precompute.entries.solver import EntrySolver
from precompute.model.assembly import assemble
from precompute.sampling.places import solve_place_receptances
from tests.precompute.devices import random_device, shipped


def three_actuators() -> Device:
    """A random device: a band of its own for each actuator, less than full scale allowed, levels beyond its reach."""
    device = random_device(20230247606)
    bands = ((60.0, 300.0), (60.0, 240.0), (85.0, 300.0))
    return replace(
        device,
        actuators=tuple(replace(one, band_hz=band) for one, band in zip(device.actuators, bands, strict=True)),
        levels_db=(10.0, 25.0, 40.0),
        limits=replace(device.limits, amplitude=0.8),
    )


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
