"""A bench in virtual time whose sensor is the board's own accelerometer on the simulated surface. SIMULATED."""

from engine.device import Device
from firmware_link.emulator.firmware import EmulatedFirmware
from precompute.model.assembly import assemble
from precompute.model.modal import compute_basis
from tactable.measure.sensor import SensorError
from tactable.measure.simulated_bench import BOOT_ID, FINE_MODES, MOVING_NS, ConverterFlaws
from tactable.measure.virtual_line import VirtualLine
from tactable.rig.accelerometer import EmulatedAccelerometer, SensedBoard, with_accelerometer
from tactable.rig.emulate import configuration_of

_OF_CONVERTERS = {"hum_m_per_s2": "hum", "drops_per_s": "drops", "jitter_s": "jitter"}


class BoardBench(VirtualLine):
    """Port, clock and person at the surface `true`, of whose actuators `board` says the full scales. SIMULATED.

    Raises SensorError for flaws that an accelerometer on the board cannot have, and for a place beside it.
    """

    def __init__(
        self,
        true: Device,
        flaws: ConverterFlaws,
        seed: int,
        sensor_mass_kg: float,
        board: Device | None = None,
        *,
        is_fine: bool = False,
    ) -> None:
        for name, flaw in _OF_CONVERTERS.items():
            if getattr(flaws, name):
                raise SensorError(f"--flaws {flaw}: is of a converter, and the board's own accelerometer has none")
        self.firmware = EmulatedFirmware(with_accelerometer(configuration_of(board or true, BOOT_ID)))
        kept = (flaws.drift, flaws.gain, flaws.offset_m_per_s2, flaws.noise_m_per_s2)
        part = EmulatedAccelerometer(true.surface.corner_m / 2, sensor_mass_kg, *kept)
        basis = compute_basis(assemble(true), FINE_MODES if is_fine else None)
        self._sensed = SensedBoard(self.firmware, true, part, seed, basis)
        super().__init__(self._sensed)

    def place(self, position_m: complex) -> None:
        """Put the sensor here; that takes as long as the surface takes to come to rest."""
        self.run_to(self.time_ns + MOVING_NS)
        self._sensed.place(position_m)

    def turn_over(self) -> None:
        """Turn the sensor over, so that gravity shows with the other sign."""
        self._sensed.turn_over()
