"""Checks whether touches can be read and commands be written on this machine, with remedies. Changes nothing."""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from engine.touch import DescriptorError, Digitizer, DigitizerError, open_digitizer
from engine.touch.sources import hid_discovery
from engine.touch.sources.evdev import EvdevModule, load_evdev
from engine.touch.sources.hidraw import read_descriptor
from firmware_link.host.serial_port import PortDescription, find_ports
from tactable.audio.interfaces import Interface, find_interfaces
from tactable.doctor import Check
from tactable.doctor.ports import SystemFiles, check_ports, port_rules, rule_remedy


@dataclass(frozen=True)
class Machine:
    """Access to the machine's digitizers, ports, files and sound cards, which tests replace."""

    hid: Callable[[], hid_discovery.HidSystem] = hid_discovery.load_hid_system
    evdev: Callable[[], EvdevModule | None] = load_evdev
    ports: Callable[[], Sequence[PortDescription]] = find_ports
    files: SystemFiles = field(default_factory=SystemFiles)
    cards: Callable[[], Sequence[Interface]] = find_interfaces


def open_found(
    system: hid_discovery.HidSystem, device: hid_discovery.HidDigitizer
) -> tuple[Digitizer | None, str | None]:
    """The digitizer of a found device, from its descriptor, and why it cannot be used; None where it can."""
    try:
        descriptor = read_descriptor(system, device)
        digitizer = open_digitizer(descriptor, device.vendor_id, device.product_id, device.report_id)
    except (DescriptorError, DigitizerError) as error:
        return None, str(hid_discovery.undecodable(system, device, error))
    if not os.access(device.path, os.R_OK):
        return digitizer, str(hid_discovery.refusal(device, PermissionError()))
    return digitizer, None


def examine(machine: Machine) -> list[Check]:
    """Every check, in the order of the chain from touch to wire."""
    try:
        system = machine.hid()
        found = hid_discovery.find_digitizers(system)
    except DigitizerError as error:
        checks = [Check("hidapi", str(error), "run `pip install -U hidapi`")]
    else:
        checks = [Check("hidapi", "module hidraw"), *_check_digitizers(system, found)]
    return [*checks, *check_ports(machine.ports(), machine.files)]


def _check_digitizers(system: hid_discovery.HidSystem, found: Sequence[hid_discovery.HidDigitizer]) -> list[Check]:
    if not found:
        return [Check("digitizer", "none found", "plug one in; without one, `tactable demo` needs no hardware")]
    checks = []
    for device in found:
        _, problem = open_found(system, device)
        what, name = f"digitizer {device.path}", device.name or device.number
        if problem is None:
            checks.append(Check(what, f"{name}: readable"))
        elif not os.access(device.path, os.R_OK):
            checks.append(Check(what, f"{name}: no permission", rule_remedy(device.number, "device")))
        else:
            node = hid_discovery.find_event_node(system, device) or "another digitizer, or a page's pointer events"
            checks.append(Check(what, problem, f"use {node}"))
    return checks


def rules_text(machine: Machine, name: str | None) -> str:
    """The udev file for one digitizer or serial port (by any of its names), or for all of them.

    A vendor:product need not be present. Raises `DigitizerError` where there is no such device.
    """
    number = None if name is None else hid_discovery.parse_number(name)
    if number is not None:
        rules = {hid_discovery.udev_rule(*number): name or ""}
    else:
        ports = [port for port in machine.ports() if name in (None, port.path, port.stable_id)]
        rules = {rule: port.description for port in ports for rule in port_rules(port)}
        if name is None or not ports:
            rules = _digitizer_rules(machine, name) | rules
    if not rules:
        raise DigitizerError("no digitizer and no USB serial port found to write a rule for: plug one in")
    lines = [f"# tactable: put into {hid_discovery.RULE_FILE}; the name must sort before 73-seat-late.rules"]
    lines.append('# Without a seat (a kiosk, a service) write MODE="0660", GROUP="input" in place of TAG+="uaccess".')
    for rule, device_name in rules.items():
        lines += [f"# {device_name}", rule]
    return "\n".join(lines)


def _digitizer_rules(machine: Machine, name: str | None) -> dict[str, str]:
    found = hid_discovery.find_digitizers(machine.hid())
    chosen = found if name is None else (hid_discovery.select_digitizer(name, found),)
    return {hid_discovery.udev_rule(device.vendor_id, device.product_id): device.name for device in chosen}
