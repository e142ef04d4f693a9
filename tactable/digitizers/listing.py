"""Lists the digitizers, serial ports and sound cards of this machine, as rows for people and for JSON."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from engine.touch import DescriptorError, Digitizer, DigitizerError, open_digitizer
from engine.touch.sources.evdev import find_evdev_digitizers, open_evdev
from engine.touch.sources.hid_discovery import HidDigitizer, HidSystem, find_digitizers
from engine.touch.sources.recording import read_recording
from tactable.audio.names import PREFIX, AudioError
from tactable.audio.names import SIMULATED as SIMULATED_CARD
from tactable.doctor.touch_check import Machine, open_found
from tactable.shipped import DEMO_RECORDING

SIMULATED = "simulated"  # stable id of the simulated digitizer: the touches of the demo, played once
_MARK = "SIMULATED"


def list_devices(machine: Machine) -> dict[str, list[Any]]:
    """Digitizers, serial ports and sound cards, and problems that keep others from being found."""
    problems: list[str] = []
    digitizers = [*_hid_rows(machine, problems), *_evdev_rows(machine), _simulated_row()]
    ports = [
        {key: getattr(port, key) for key in ("path", "stable_id", "description")}
        | {"simulated": _MARK in port.description}
        for port in machine.ports()
    ]
    form = {"outputs": 2, "inputs": 0, "rate_hz": 48_000.0, "output_latency_ms": 10.0, "simulated": True}
    simulated_card = {"name": f"no card ({_MARK})", "choose_by": PREFIX + SIMULATED_CARD, **form}
    cards = [*_card_rows(machine, problems), simulated_card]
    return {"digitizers": digitizers, "serial_ports": ports, "sound_cards": cards, "problems": problems}


def _card_rows(machine: Machine, problems: list[str]) -> list[dict[str, Any]]:
    try:
        cards = machine.cards()
    except AudioError as error:
        problems.append(str(error))
        return []
    return [
        {
            "name": card.name,
            "choose_by": PREFIX + card.name,
            "outputs": card.outputs,
            "inputs": card.inputs,
            "rate_hz": card.rate_hz,
            "output_latency_ms": 1e3 * card.output_latency_s,
            "simulated": False,
        }
        for card in cards
    ]


def _hid_rows(machine: Machine, problems: list[str]) -> list[dict[str, Any]]:
    try:
        system = machine.hid()
        return [row for device in find_digitizers(system) for row in _rows_of(system, device, problems)]
    except DigitizerError as error:
        problems.append(str(error))
        return []


def _rows_of(system: HidSystem, device: HidDigitizer, problems: list[str]) -> Iterator[dict[str, Any]]:
    """A row for the device, or for each of its touch surfaces where it has several."""
    digitizer, problem = open_found(system, device)
    if digitizer is not None:
        refused = digitizer.refused if device.report_id is None else ()
        problems += [f"{device.path}: one of its touch surfaces cannot be decoded: {error}" for error in refused]
        if device.report_id is None and len(digitizer.surfaces) > 1:
            for each in digitizer.surfaces:
                yield from _rows_of(system, replace(device, report_id=each.report_id), problems)
            return
    surface = None if digitizer is None else digitizer.surface.name(device.vendor_id, device.product_id)
    name, stable_id = device.name, device.stable_id
    if digitizer is not None and device.report_id is not None:
        name, stable_id = f"{name} ({digitizer.surface.label}, {surface})", f"{stable_id}#{device.report_id:02x}"
    known = {"vendor_product": device.number, "serial_number": device.serial_number or None, "surface": surface}
    yield _row(name, device.path, stable_id, "hidraw", problem, digitizer) | known


def _evdev_rows(machine: Machine) -> list[dict[str, Any]]:
    evdev = machine.evdev()
    rows = []
    for device in find_evdev_digitizers(evdev) if evdev is not None else ():
        digitizer, slots, problem = None, None, None
        try:
            source = open_evdev(device.path, evdev)
            digitizer, slots = open_digitizer(source.descriptor), source.slots
            source.close()
        except (DescriptorError, DigitizerError, OSError) as error:
            problem = str(error)
        row = _row(device.name, device.path, device.stable_id, "evdev", problem, digitizer)
        rows.append({**row, "contact_maximum": slots})
    return rows


def _simulated_row() -> dict[str, Any]:
    recording = read_recording(DEMO_RECORDING)
    digitizer = open_digitizer(recording.descriptor, recording.vendor_id, recording.product_id)
    return _row(recording.name, str(DEMO_RECORDING), SIMULATED, "recording", None, digitizer)


def _row(
    name: str, path: str, stable_id: str, source: str, problem: str | None, digitizer: Digitizer | None
) -> dict[str, Any]:
    known = dict[str, Any].fromkeys(("kind", "width_mm", "height_mm", "contact_maximum"))
    if digitizer is not None:
        surface, most = digitizer.surface, digitizer.plan.maximum_contacts
        known = dict(
            zip(known, (surface.kind.name.lower(), surface.x.extent_mm, surface.y.extent_mm, most), strict=True)
        )
    row = {"name": name, "path": path, "stable_id": stable_id, "source": source, **known}
    return row | {"usable": problem is None, "problem": problem, "simulated": _MARK in name}
