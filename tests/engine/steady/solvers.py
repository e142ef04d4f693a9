"""Solvers of drives at positions for the shipped devices and others, with what a test needs beside them."""

from functools import cache

from engine.device import Device
from precompute.predict.at_positions import SteadyDesigner
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
