"""The circle of a calibration: the bar is measured before the fit, and plays the new table before that is put in place.

Theory of operation. Each step leaves the table that a run plays as it was: the measurement writes its own file, the fit
its own folder, the build a file beside the table. Only a table that the bar was seen to keep is renamed into place. So
Ctrl-C at any instant leaves the old table, a board that is silent, and what was complete; the same command goes on from
there. Drives are verified before the first change of the table, clicks before the second.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from threadpoolctl import threadpool_limits

from base.plain import to_plain
from engine.device import Device
from engine.table import Table
from precompute.measurements.measurement_file import check_ending, write_measurements
from precompute.measurements.model import even_places
from precompute.measurements.types import Kind, MeasurementError
from precompute.sampling.placements import Anywhere, random_placements
from tactable.measure.apparatus import Apparatus, ApparatusOptions
from tactable.measure.board_sensor import fixed_places
from tactable.measure.stepped_sine import Reading
from tactable.measure.verification import Judgement, Verdict, plan_played, verify_table
from tactable.measure.walk import Method, RawFolder, Stop, measure_walk, measurements_of

LEVEL_DB = 20.0  # DEFAULT_LEVEL_DB of engine.table.levels
PLACES, PLACEMENTS = 3, 5  # 15 points of drives and 15 of clicks: minutes; `verify` takes more
_DOUBTS = {
    Verdict.BROKEN: "the {0} does not keep what the new table promises",
    Verdict.IN_PART: "too few readings of the new table on the {0} show that it is kept",
    Verdict.NOT_SHOWN: "no reading of the new table on the {0} shows whether it is kept",
}


@dataclass(frozen=True)
class Circle:
    """An apparatus at the bar of `device`, and how the bar is measured; `options` opened the apparatus."""

    device: Device
    apparatus: Apparatus
    options: ApparatusOptions
    walk: Sequence[Stop]
    method: Method

    def measure(self, path: Path, on_reading: Callable[[Stop, Reading], None]) -> tuple[int, int]:
        """Measure the bar into a file of complex responses; one that this measurement wrote before is kept.

        Returns how many readings stayed spoiled, and are left out of the file, and how many there are. Raises
        MeasurementError where no reading is usable, where a drive is not recorded and for a file of another
        measurement, SensorError and LinkError.
        """
        check_ending(path)
        form, options = self.apparatus.sensor.form, self.options
        if any(form.loopback(actuator.name) is None for actuator in self.device.actuators):
            raise MeasurementError("an actuator has no loopback channel: add it, or take and fit peaks by `measure`")
        raw = path.with_name(f"{path.name}.raw")
        if path.exists() and not raw.is_dir():
            raise MeasurementError(f"{path}: exists and was not measured by this command; give another file")
        known = {"form": form, "method": self.method, "mass_kg": options.sensor_mass_kg, "flaws": options.flaws}
        folder = RawFolder(raw, self.device, self.walk, to_plain(known) | {"seed": options.seed})
        with threadpool_limits(1, "blas"):
            records = measure_walk(self.device, self.walk, self.apparatus, self.method, folder, on_reading)
        if not path.exists():
            how = {"is_simulated": form.is_simulated}
            found = measurements_of(records, self.device, options.sensor_mass_kg, Kind.RESPONSE, **how)
            comment = f"{'SIMULATED ' if form.is_simulated else ''}tactable calibrate --measure {self.device.name}"
            write_measurements(path, found, self.device, comment)
        readings = [reading for record in records for reading in record.readings]
        return sum(reading.is_spoiled for reading in readings), len(readings)

    def verify(self, written: Path) -> str:
        """Play a table's drives and clicks; the doubt that remains, empty for none."""
        asked = Anywhere(placements=PLACEMENTS, seed=self.options.seed + 1)
        with Table.open(written, verify=False) as table, threadpool_limits(1, "blas"):
            played = plan_played(table, random_placements(table.device, asked), LEVEL_DB)
            places_m = fixed_places(table.device, self.options.sensor, even_places(table.device, PLACES).tolist())
            points = verify_table(table, played, places_m, self.apparatus, self.options.sensor_mass_kg)
        judgement = Judgement.of(points)
        doubt = _DOUBTS.get(judgement.verdict)
        return "" if doubt is None else f"{doubt.format(self.device.surface.kind)}: {judgement}"
