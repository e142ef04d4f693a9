"""The board, the sensor and the person who moves it: real ones, or a simulated bench in the place of all three."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from engine.device import Device
from engine.loop import Clock, SystemClock
from firmware_link.host.session import Port
from firmware_link.protocol.basis import Basis
from precompute.measurements.parameters import with_changes
from tactable.audio.board import core_library
from tactable.audio.names import PREFIX, is_audio, parse_input, parse_output
from tactable.audio.names import SIMULATED as SIMULATED_CARD
from tactable.audio.port import open_port
from tactable.audio.simulated_card import CardFlaws, SimulatedCard
from tactable.measure.audio_sensor import AudioSensor
from tactable.measure.board_bench import BoardBench
from tactable.measure.board_sensor import BoardSensor, Losses, fixed_position_m, is_board, open_board_sensor
from tactable.measure.driven_device import DrivenDevice
from tactable.measure.sample_stream import SampleStream
from tactable.measure.sensor import Sensor, SensorError
from tactable.measure.simulated_bench import ConverterFlaws, SimulatedBench, SimulatedSensor
from tactable.shipped import cache_folder

SIMULATED = "simulated"
_VIRTUAL_BIT_RATE_HZ = 1_000_000


@dataclass(frozen=True)
class ApparatusOptions:
    """port and sensor: names, or both simulated; most: amplitude that the board is armed for; the rest is simulated.

    A name is a serial port or a pipe of samples, "audio:NAME,..." for a sound card, or "simulated". The sensor may be
    "board", the accelerometer of the board itself, or "board:35mm", where it is fixed at that place.

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
        port, sensor = (_is_simulated(name) for name in (self.port, self.sensor))
        if is_board(self.sensor):
            return port
        if port != sensor:
            raise SensorError("--port and --sensor: simulate both or neither; they share one bar")
        return port


@dataclass(frozen=True)
class Apparatus:
    """open_driven arms the board; guide has the sensor put at a place, in metres; turn_over has it turned over."""

    sensor: Sensor
    open_driven: Callable[[], DrivenDevice]
    guide: Callable[[float], None]
    turn_over: Callable[[], None]

    @property
    def losses(self) -> Losses | None:
        """What line and board lost of the samples of the board's accelerometer; None for another sensor."""
        return self.sensor.losses if isinstance(self.sensor, BoardSensor) else None


@contextmanager
def open_apparatus(device: Device, options: ApparatusOptions, ask: Callable[[str], None]) -> Iterator[Apparatus]:
    """Board and sensor for the length of a `with` block; `ask` tells a person what to do and returns once it is done.

    Raises SensorError and LinkError.
    """
    most = [options.most] * len(device.actuators)
    if is_board(options.sensor):
        with _open_board(device, options, ask) as apparatus:
            yield apparatus
        return
    if options.is_simulated:
        bench = simulated_bench(device, options)
        yield Apparatus(
            SimulatedSensor(bench),
            lambda: DrivenDevice(device, bench, bench, most, clicks=options.clicks),
            bench.place,
            bench.turn_over,
        )
        return
    with (
        open_port(options.port, options.bit_rate_hz) as port,
        closing(_open_sensor(options.sensor, device)) as stream,
    ):
        yield Apparatus(
            stream,
            lambda: DrivenDevice(device, port, SystemClock(), most, port.bit_rate_hz, options.clicks),
            lambda position_m: ask(f"sensor to {1e3 * position_m:.1f} mm, then Enter"),
            lambda: ask("turn the sensor over, then Enter"),
        )


@contextmanager
def _open_board(device: Device, options: ApparatusOptions, ask: Callable[[str], None]) -> Iterator[Apparatus]:
    """A board with its own accelerometer, which is moved by hand or fixed, or the simulated bench of one."""
    if is_audio(options.port):
        raise SensorError("--sensor board: a sound card has no accelerometer of its own; name a converter for one")
    if options.is_simulated:
        true = with_changes(device, options.changes)
        bench = BoardBench(
            true, options.flaws, options.seed, options.sensor_mass_kg, board=device, is_fine=options.is_fine
        )
        with closing(open_board_sensor(device, bench, bench, _VIRTUAL_BIT_RATE_HZ)) as sensor:
            driven = partial(_driven_by, device, bench, bench, _VIRTUAL_BIT_RATE_HZ, options, sensor)
            yield Apparatus(sensor, driven, bench.place, bench.turn_over)
        return
    is_fixed, clock = fixed_position_m(options.sensor, device) is not None, SystemClock()
    with (
        open_port(options.port, options.bit_rate_hz) as port,
        closing(open_board_sensor(device, port, clock, port.bit_rate_hz)) as sensor,
    ):
        yield Apparatus(
            sensor,
            partial(_driven_by, device, port, clock, port.bit_rate_hz, options, sensor),
            lambda position_m: None if is_fixed else ask(f"sensor to {1e3 * position_m:.1f} mm, then Enter"),
            lambda: ask("turn the sensor over, then Enter"),
        )


def _driven_by(
    device: Device, port: Port, clock: Clock, bit_rate_hz: int, options: ApparatusOptions, sensor: BoardSensor
) -> DrivenDevice:
    most = [options.most] * len(device.actuators)
    return DrivenDevice(device, port, clock, most, bit_rate_hz, options.clicks, sensor)


def simulated_bench(device: Device, options: ApparatusOptions) -> SimulatedBench:
    """The bench of options that are simulated; a sound card for board and converter is one card with one clock."""
    true, form, card = with_changes(device, options.changes), dict[str, Any](), None
    if is_audio(options.sensor):
        source = parse_input(options.sensor, [actuator.name for actuator in device.actuators])
        clips_at = min(options.flaws.clips_at_m_per_s2, source.scale_m_per_s2)
        flaws = replace(options.flaws, clips_at_m_per_s2=clips_at)
        form = {"sample_rate_hz": float(source.rate_hz), "has_loopback": bool(source.loopbacks)}
        form["has_sum"] = len(source.loopbacks) == 1
    else:
        flaws = options.flaws
    if is_audio(options.port):
        drift = flaws.drift if is_audio(options.sensor) else 0.0
        card = SimulatedCard(
            core_library(cache_folder()), parse_output(options.port), CardFlaws(drift=drift), options.seed
        )
    return SimulatedBench(
        true, flaws, options.seed, options.sensor_mass_kg, board=device, is_fine=options.is_fine, card=card, **form
    )


def _is_simulated(name: str) -> bool:
    return name == SIMULATED or name.split(",", 1)[0].strip() == PREFIX + SIMULATED_CARD


def _open_sensor(name: str, device: Device) -> SampleStream:
    return AudioSensor(name, device) if is_audio(name) else SampleStream(Path(name), device)
