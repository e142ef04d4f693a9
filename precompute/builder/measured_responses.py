"""The group `measured` of a table: the responses that it was built from, and their interpolation errors."""

import numpy as np

from engine.device import Device
from engine.table import Table
from engine.table.netcdf_file import TableWriter, Variable
from precompute.measurements.response_table import MeasuredResponses, estimate_errors, measured_plant
from precompute.model.assembly import assemble
from precompute.model.plant import Plant

MODEL = "model"
MEASURED = "measured responses"
_GROUP = "measured"
_FORCES = ", the full scale of responses per newton"
_ERRORS = {
    "between_frequencies_error": "bound on what is read between frequencies, of the greatest; ESTIMATE",
    "between_places_error": "the same between places; ESTIMATE",
    "model_disagreement": "distance of the model from the measured responses, median over the frequencies",
}
_RESPONSE = ("frequency", "actuator", "position", "part")


def source_attributes(responses: MeasuredResponses | None) -> dict[str, str]:
    """Attributes of a table that name the source of its responses."""
    if responses is None:
        return {"source": MODEL}
    simulated = " (SIMULATED)" if responses.is_simulated else ""
    return {
        "source": MEASURED + simulated,
        "responses_file": responses.name,
        "responses_sha256": responses.sha256,
        "modelled": f"what fingers do, rise times and clicks{_FORCES * responses.is_per_newton}; ESTIMATE",
    }


def write_measured(writer: TableWriter, device: Device, responses: MeasuredResponses) -> None:
    """Write the responses and the errors of what is interpolated from them."""
    writer.write(_GROUP, Variable("frequency", ("frequency",), "Hz", "measured at"), responses.frequency_hz)
    writer.write(_GROUP, Variable.names("actuator"), [actuator.name for actuator in device.actuators])
    position = Variable("position", ("position",), "m", "of the sensor, from the surface's start")
    writer.write_points(_GROUP, position, responses.position_m)
    writer.write(_GROUP, Variable("part", ("part",), "1", "of a complex number"), ["real", "imaginary"])
    acceleration = Variable(
        "acceleration", _RESPONSE, "m s-2", "untouched, one actuator at full scale, sensor taken off"
    )
    split = np.stack([responses.acceleration.real, responses.acceleration.imag], axis=-1)
    writer.write(_GROUP, acceleration, split)
    errors = estimate_errors(device, responses)
    found = (errors.between_frequencies, errors.between_places, errors.model)
    for (name, meaning), values in zip(_ERRORS.items(), found, strict=True):
        writer.write(_GROUP, Variable(name, ("actuator",), "1", meaning), values)


def plant_of(table: Table) -> Plant:
    """The plant that a table was built from."""
    if str(table.attributes.get("source", MODEL)) == MODEL:
        return assemble(table.device)
    split = table.values(_GROUP, "acceleration")
    responses = MeasuredResponses(
        frequency_hz=table.values(_GROUP, "frequency"),
        position_m=table.points(_GROUP, "position"),
        acceleration=split[..., 0] + 1j * split[..., 1],
        name=str(table.attributes["responses_file"]),
        sha256=str(table.attributes["responses_sha256"]),
        is_simulated="SIMULATED" in str(table.attributes["source"]),
        is_per_newton=_FORCES in str(table.attributes["modelled"]),
    )
    return measured_plant(table.device, responses)


def interpolation_errors_of(table: Table) -> dict[str, dict[str, float]]:
    """Errors of a table's measured responses by actuator (measurements.plant.InterpolationErrors)."""
    names = [actuator.name for actuator in table.device.actuators]
    return {key: dict(zip(names, table.values(_GROUP, key).tolist(), strict=True)) for key in _ERRORS}
