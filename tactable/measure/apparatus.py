"""The board, the sensor and the person who moves it: real ones, or a simulated bench in the place of all three."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from engine.device import Device
from engine.loop import SystemClock
from firmware_link.protocol.basis import Basis
from precompute.measurements.parameters import with_changes
from tactable.audio.port import open_port
from tactable.measure.driven_device import DrivenDevice
from tactable.measure.sample_stream import SampleStream
from tactable.measure.sensor import Sensor, SensorError
from tactable.measure.simulated_bench import ConverterFlaws, SimulatedBench, SimulatedSensor

SIMULATED = "simulated"


@dataclass(frozen=True)
class ApparatusOptions:
    """port and sensor: names, or both "simulated"; most: amplitude that the board is armed for; the rest is simulated.

    changes: values (SI) by parameter of the simulated bar; what `device` says stays what is believed.
    """

    port: str
    sensor: str
    most: float
    bit_rate_hz: int = 115_200
    sensor_mass_kg: float = 0.0
    flaws: ConverterFlaws = field(default_factory=ConverterFlaws)
    changes: Mapping[str, float] = field(default_factory=dict)
    seed: int = 0
    is_fine: bool = False
    """Whether the simulated bar has so many modes and samples that it errs by less than 0.001 dB."""
    clicks: Basis | None = None
    """The basis of clicks that the board is to hold."""

    @property
    def is_simulated(self) -> bool:
        """Whether there is a simulated bench. Raises SensorError where only one of the two is simulated."""
        if (self.port == SIMULATED) != (self.sensor == SIMULATED):
            raise SensorError("--port and --sensor: simulate both or neither; they share one bar")
        return self.port == SIMULATED


@dataclass(frozen=True)
class Apparatus:
    """open_driven arms the board; guide has the sensor put at a place, in metres; turn_over has it turned over."""

    sensor: Sensor
    open_driven: Callable[[], DrivenDevice]
    guide: Callable[[float], None]
    turn_over: Callable[[], None]


@contextmanager
def open_apparatus(device: Device, options: ApparatusOptions, ask: Callable[[str], None]) -> Iterator[Apparatus]:
    """Board and sensor for the length of a `with` block; `ask` tells a person what to do and returns once it is done.

    Raises SensorError and LinkError.
    """
    most = [options.most] * len(device.actuators)
    if options.is_simulated:
        true = with_changes(device, options.changes)
        bench = SimulatedBench(
            true, options.flaws, options.seed, options.sensor_mass_kg, board=device, is_fine=options.is_fine
        )
        yield Apparatus(
            SimulatedSensor(bench),
            lambda: DrivenDevice(device, bench, bench, most, clicks=options.clicks),
            bench.place,
            bench.turn_over,
        )
        return
    with (
        open_port(options.port, options.bit_rate_hz) as port,
        closing(SampleStream(Path(options.sensor), device)) as stream,
    ):
        yield Apparatus(
            stream,
            lambda: DrivenDevice(device, port, SystemClock(), most, port.bit_rate_hz, options.clicks),
            lambda position_m: ask(f"sensor to {1e3 * position_m:.1f} mm, then Enter"),
            lambda: ask("turn the sensor over, then Enter"),
        )
