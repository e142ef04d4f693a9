"""The group `measured` of a table: the responses it was built from, and how far they can be trusted."""

import numpy as np

from engine.device import Device
from engine.table import Table
from engine.table.file import TableWriter, Variable
from precompute.measurements.plant import doubt, measured_plant
from precompute.measurements.responses import MeasuredResponses
from precompute.model.assembly import Plant, assemble

MODEL = "model"
MEASURED = "measured responses"
_GROUP = "measured"
_DOUBTS = {
    "between_frequencies_error": "bound on what is read between frequencies, of the greatest; ESTIMATE",
    "between_places_error": "the same between places along the bar; ESTIMATE",
    "model_disagreement": "distance of the model from the measured responses, median over the frequencies",
}
_RESPONSE = ("frequency", "actuator", "position", "part")


def source_attributes(responses: MeasuredResponses | None) -> dict[str, str]:
    """What a table says of where its responses are from."""
    if responses is None:
        return {"source": MODEL}
    simulated = " (SIMULATED)" if responses.is_simulated else ""
    return {
        "source": MEASURED + simulated,
        "responses_file": responses.name,
        "responses_sha256": responses.sha256,
        "modelled": "what fingers do to the bar, rise times and clicks; ESTIMATE",
    }


def write_measured(writer: TableWriter, device: Device, responses: MeasuredResponses) -> None:
    """Write them, and the doubts about them."""
    writer.write(_GROUP, Variable("frequency", ("frequency",), "Hz", "measured at"), responses.frequency_hz)
    writer.write(_GROUP, Variable.names("actuator"), [actuator.name for actuator in device.actuators])
    position = Variable("position", ("position",), "m", "of the sensor, from the bar's start")
    writer.write(_GROUP, position, responses.position_m)
    writer.write(_GROUP, Variable("part", ("part",), "1", "of a complex number"), ["real", "imaginary"])
    acceleration = Variable(
        "acceleration", _RESPONSE, "m s-2", "untouched, one actuator at full scale, sensor taken off"
    )
    split = np.stack([responses.acceleration.real, responses.acceleration.imag], axis=-1)
    writer.write(_GROUP, acceleration, split)
    doubts = doubt(device, responses)
    found = (doubts.between_frequencies, doubts.between_places, doubts.model)
    for (name, meaning), values in zip(_DOUBTS.items(), found, strict=True):
        writer.write(_GROUP, Variable(name, ("actuator",), "1", meaning), values)


def plant_of(table: Table) -> Plant:
    """The plant that a table was built from."""
    if str(table.attributes.get("source", MODEL)) == MODEL:
        return assemble(table.device)
    split = table.values(_GROUP, "acceleration")
    responses = MeasuredResponses(
        frequency_hz=table.values(_GROUP, "frequency"),
        position_m=table.values(_GROUP, "position"),
        acceleration=split[..., 0] + 1j * split[..., 1],
        name=str(table.attributes["responses_file"]),
        sha256=str(table.attributes["responses_sha256"]),
        is_simulated="SIMULATED" in str(table.attributes["source"]),
    )
    return measured_plant(table.device, responses)


def doubts_of(table: Table) -> dict[str, dict[str, float]]:
    """How far the measured responses of a table can be trusted, each by actuator (measurements.plant.Doubts)."""
    names = [actuator.name for actuator in table.device.actuators]
    return {key: dict(zip(names, table.values(_GROUP, key).tolist(), strict=True)) for key in _DOUBTS}
