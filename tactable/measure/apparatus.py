"""The board, the sensor and the person who moves it: real ones, or a simulated bench in the place of all three."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from base.points import point_text
from engine.device import Device
from engine.loop.loop import SystemClock
from firmware_link import BIT_RATE_HZ
from firmware_link.host.session import Port
from firmware_link.protocol.basis import Basis
from precompute.measurements.parameters import with_changes
from tactable.audio.board import core_library
from tactable.audio.names import PREFIX, is_audio, parse_input, parse_output
from tactable.audio.names import SIMULATED as SIMULATED_CARD
from tactable.audio.port import open_port
from tactable.audio.simulated_card import CardFlaws, SimulatedCard
from tactable.measure.audio_process import AudioSensor
from tactable.measure.board_sensor import BoardSensor, Losses, fixed_position_m, is_board, open_board_sensor
from tactable.measure.driven_device import DrivenDevice
from tactable.measure.sensor import SampleStream, Sensor, SensorError
from tactable.measure.simulated_bench import BoardBench, ConverterFlaws, SimulatedBench, SimulatedSensor
from tactable.shipped import cache_folder

SIMULATED = "simulated"


@dataclass(frozen=True)
class ApparatusOptions:
    """port and sensor: names, or both simulated; most: amplitude that the board is armed for; the rest is simulated.

    A name is a serial port or a pipe of samples, "audio:NAME,..." for a sound card, or "simulated". The sensor may be
    "board", the accelerometer of the board itself, or "board:35mm", on a plate "board:35x60mm", where it is fixed.

    changes: values (SI) by parameter of the simulated bar; what `device` says stays what is believed.
    """

    port: str
    sensor: str
    most: float
    bit_rate_hz: int = BIT_RATE_HZ
    sensor_mass_kg: float = 0.0
    flaws: ConverterFlaws = field(default_factory=ConverterFlaws)
    changes: Mapping[str, float] = field(default_factory=dict)
    seed: int = 0
    is_fine: bool = False  # whether the simulated bar has enough modes and samples to err by less than 0.001 dB
    clicks: Basis | None = None  # the basis of clicks that the board is to hold

    @property
    def is_simulated(self) -> bool:
        """Whether there is a simulated bench. Raises SensorError where only one of the two is simulated."""
        words = ((name, name.split(",", 1)[0].strip()) for name in (self.port, self.sensor))
        port, sensor = (name == SIMULATED or word == PREFIX + SIMULATED_CARD for name, word in words)
        if is_board(self.sensor):
            return port
        if port != sensor:
            raise SensorError("--port and --sensor: simulate both or neither; they share one bar")
        return port


@dataclass(frozen=True)
class Apparatus:
    """open_driven arms the board; guide has the sensor put at a point; turn_over has it turned over."""

    sensor: Sensor
    open_driven: Callable[[], DrivenDevice]
    guide: Callable[[complex], None]
    turn_over: Callable[[], None]

    @property
    def losses(self) -> Losses | None:
        """Samples of the board's accelerometer that line and board lost; None for another sensor."""
        return self.sensor.losses if isinstance(self.sensor, BoardSensor) else None


@contextmanager
def open_apparatus(device: Device, options: ApparatusOptions, ask: Callable[[str], None]) -> Iterator[Apparatus]:
    """Board and sensor for the length of a `with` block; `ask` tells a person what to do and returns once it is done.

    The board's own accelerometer is moved by hand, or fixed. Raises SensorError and LinkError.
    """
    is_own = is_board(options.sensor)
    if is_own and is_audio(options.port):
        raise SensorError("--sensor board: a sound card has no accelerometer of its own; name a converter for one")
    is_fixed = fixed_position_m(options.sensor, device) is not None
    with ExitStack() as stack:
        bench = _simulated_bench(device, options) if options.is_simulated else None
        port: Port
        if bench is None:
            opened = open_port(options.port, options.bit_rate_hz)
            port, bit_rate_hz = opened, opened.bit_rate_hz
            stack.callback(opened.close)
        else:
            port, bit_rate_hz = bench, options.bit_rate_hz
        clock = bench or SystemClock()
        own = open_board_sensor(device, port, clock, bit_rate_hz) if is_own else None
        made = SimulatedSensor(bench) if isinstance(bench, SimulatedBench) else None
        sensor = own or made or open_sensor(options.sensor, device)
        stack.callback(sensor.close)
        most = [options.most] * len(device.actuators)

        def guide(position_m: complex) -> None:
            if not is_fixed:
                ask(f"sensor to {point_text(position_m, 1, 'f')}, then Enter")

        yield Apparatus(
            sensor,
            partial(DrivenDevice, device, port, clock, most, bit_rate_hz, options.clicks, own),
            guide if bench is None else bench.place,
            bench.turn_over if bench else lambda: ask("turn the sensor over, then Enter"),
        )


def open_sensor(name: str, device: Device) -> SampleStream:
    """The sound card of that name, or the file or pipe of samples. Raises AudioError and SensorError."""
    return AudioSensor(name, device) if is_audio(name) else SampleStream(Path(name), device)


def _simulated_bench(device: Device, options: ApparatusOptions) -> BoardBench | SimulatedBench:
    """The bench of options that are simulated; a sound card for board and converter is one card with one clock."""
    true, flaws, card = with_changes(device, options.changes), options.flaws, None
    form: dict[str, Any] = {"board": device, "is_fine": options.is_fine}
    if is_board(options.sensor):
        return BoardBench(true, flaws, options.seed, options.sensor_mass_kg, **form)
    if is_audio(options.sensor):
        source = parse_input(options.sensor, [actuator.name for actuator in device.actuators])
        flaws = replace(flaws, clips_at_m_per_s2=min(flaws.clips_at_m_per_s2, source.scale_m_per_s2))
        form |= {"sample_rate_hz": float(source.rate_hz), "has_loopback": bool(source.loopbacks)}
        form["has_sum"] = len(source.loopbacks) == 1
    if is_audio(options.port):
        drift = CardFlaws(drift=flaws.drift if is_audio(options.sensor) else 0.0)
        card = SimulatedCard(core_library(cache_folder()), parse_output(options.port), drift, options.seed)
    return SimulatedBench(true, flaws, options.seed, options.sensor_mass_kg, card=card, **form)
