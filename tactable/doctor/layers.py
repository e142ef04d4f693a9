"""Measures each layer between touch and drive for about a second, and names the one that costs most."""

import contextlib
import os
import select
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from engine.loop.observer import Percentiles
from engine.render.board_fit import play_ns
from engine.table import Table, TableError
from engine.table.levels import DEFAULT_LEVEL_DB
from engine.touch import Placement, open_digitizer
from engine.touch.sources.recording import read_recording
from firmware_link.emulator.pty import open_pseudo_terminal
from firmware_link.protocol.drive_words import DRIVE_SIZE
from firmware_link.protocol.framing import NS_PER_S, encode_message, occupied_ns
from firmware_link.protocol.link_errors import LinkError
from firmware_link.protocol.messages import Set, SetFlag
from tactable.doctor import Check
from tactable.shipped import DEMO_RECORDING

_WAKES = 200  # two lie beyond the 99th percentile
_PERIOD_S = 0.002  # the process must have fallen asleep in between; 200 of them take 0.4 s
_ACTUATORS = 2
_CLICK_WEIGHTS = 22  # number of weights for each actuator of a click of 30 ms between 60 and 300 Hz
_HALF_LEASE_S = 0.02  # of the default of 40 ms: a click must be on the board before its lease is half over
_PANEL_MS = 8.0  # longest wait for the panel's next frame, of the usual 125 a second: its own rate shows at a touch
_US = 1e3
_PULSES = """
import os, sys, time
for _ in range(int(sys.argv[1])):
    time.sleep(float(sys.argv[2]))
    os.write(1, time.monotonic_ns().to_bytes(8, "little"))
"""


@dataclass(frozen=True)
class Layer:
    """Delay that one layer adds between a touch and its drive: median and 99th percentile (None: unknown)."""

    name: str
    typical_us: float
    slow_us: float | None
    what: str
    remedy: str


def measure_layers(bit_rate_hz: int) -> list[Layer]:
    """Wake-up, engine, terminal and line; takes about a second. The line is computed, not measured."""
    command = encode_message(Set(0, SetFlag.WRITE_PHASE, 0, bytes(_ACTUATORS * DRIVE_SIZE)), 0)
    line_us = occupied_ns(bit_rate_hz, len(command)) / _US
    return [
        Layer(
            "host",
            *_wake_ups_us(),
            "the system wakes a process that waits",
            "`tactable run --realtime all`; `tactable bench latency` says what each step brings",
        ),
        Layer("engine", *_decoding_us(), "a report becomes a touch frame", "`tactable bench latency` has its stages"),
        Layer("terminal", *_terminal_us(), "bytes through a pseudo-terminal, as to emulators", "a real port has none"),
        Layer(
            "line",
            line_us,
            None,
            f"{len(command)} bytes of a command at {bit_rate_hz} bit/s (computed; USB ignores the rate)",
            "a faster line: `tactable run --bit-rate 2000000`, where the board can",
        ),
        Layer(
            "line for a click",
            play_ns(_ACTUATORS * _CLICK_WEIGHTS, bit_rate_hz) / _US,
            None,
            f"of 30 ms at {bit_rate_hz} bit/s, computed: {', '.join(_click_texts(bit_rate_hz))}; where it takes more "
            "than half a lease of 40 ms, steady drives take the place of clicks",
            "a faster line: `tactable run --bit-rate 2000000`, where the board can",
        ),
    ]


def _click_texts(bit_rate_hz: int) -> Iterator[str]:
    """What a PLAY for two, four and eight actuators is, and the slowest line that carries it."""
    for actuators in (2, 4, 8):
        weights = actuators * _CLICK_WEIGHTS
        ns = play_ns(weights, bit_rate_hz)
        slowest_hz = bit_rate_hz * ns / NS_PER_S / _HALF_LEASE_S
        yield f"{actuators} actuators {weights} weights in {ns / 1e6:.1f} ms (from {slowest_hz:.0f} bit/s on)"


def layers_of(bit_rate_hz: int, table: Path | None) -> list[Check]:
    """What a finger waits for with this table, then what the layers cost; or that pseudo-terminals are missing."""
    try:
        layers = measure_layers(bit_rate_hz)
    except LinkError as error:
        finding, _, remedy = str(error).partition("): ")
        return [Check("pseudo-terminals", f"{finding})", f"{remedy}; `emulate` and `demo` need them", needed=False)]
    engine_ms = sum(layer.typical_us for layer in layers if layer.name in ("host", "engine")) / _US
    panel, engine = (_PANEL_MS, "ASSUMED: a frame of 125 a second"), (engine_ms, "measured: wake-up and decoding")
    return [Check("touch to felt click", wait_text(panel, engine, bit_rate_hz, table)), *check_layers(layers)]


def wait_text(panel: tuple[float, str], engine: tuple[float, str], bit_rate_hz: int, table: Path | None) -> str:
    """What the finger waits for, in one line: panel, engine (each ms and source), line and bar, with their sources."""
    actuators, bar_ms = _told_by(table)
    line = play_ns(actuators * _CLICK_WEIGHTS, bit_rate_hz) / 1e6, f"computed: a click of {actuators} actuators"
    parts = {"panel": panel, "engine": engine, "line": line}
    if bar_ms is not None:
        parts["bar"] = bar_ms, f"SIMULATED: until the threshold, {table}"
    whole = f"{sum(ms for ms, _ in parts.values()):.1f} ms{' without the bar' if bar_ms is None else ''}"
    beside = "" if bar_ms is not None else "; a whole table with clicks tells the bar's"
    return f"{whole}: {' + '.join(f'{name} {ms:.2g} ({source})' for name, (ms, source) in parts.items())}{beside}"


def _told_by(path: Path | None) -> tuple[int, float | None]:
    """The number of actuators of a table, and the median time after which its clicks are felt.

    The clicks are those of 20 dB in the middle of each zone, felt as they pass the threshold.
    """
    actuators, after_s = _ACTUATORS, list[float]()
    with contextlib.suppress(TableError, OSError):  # `check_tables` says what is wrong with it
        if path is not None:
            with Table.open(path) as table:
                actuators = len(table.device.actuators)
                placements = [Placement.on(table.device, [zone.middle_m], []) for zone in table.device.zones]
                clicks = [table.click_at(placement, DEFAULT_LEVEL_DB) for placement in placements]
            after_s = [at_s for click in clicks if click is not None and (at_s := click.exceeds_at_s()) is not None]
    return actuators, 1e3 * statistics.median(after_s) if after_s else None


def check_layers(layers: Sequence[Layer]) -> list[Check]:
    """A check for each layer, and one that names the costliest."""
    checks = [Check(f"cost of the {layer.name}", _text(layer)) for layer in layers]
    costliest = max(layers, key=lambda layer: layer.typical_us)
    finding = f"the {costliest.name}, {costliest.typical_us:.0f} us; to have less: {costliest.remedy}"
    return [*checks, Check("layer that costs most here", finding)]


def _text(layer: Layer) -> str:
    tail = "" if layer.slow_us is None else f", one in a hundred {layer.slow_us:.0f} us"
    return f"{layer.typical_us:.1f} us{tail}: {layer.what}"


def _wake_ups_us() -> tuple[float, float]:
    """Time from a write in another process to the return of the read that waited for it."""
    command = [sys.executable, "-S", "-c", _PULSES, str(_WAKES), str(_PERIOD_S)]
    late = []
    with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        descriptor = process.stdout.fileno()
        while True:
            select.select([descriptor], [], [])
            stamp = os.read(descriptor, 8)
            now_ns = time.monotonic_ns()
            if not stamp:
                break
            late.append(now_ns - int.from_bytes(stamp, "little"))
    return _figures(late)


def _decoding_us() -> tuple[float, float]:
    recording = read_recording(DEMO_RECORDING)
    digitizer = open_digitizer(recording.descriptor, recording.vendor_id, recording.product_id)
    times_ns = []
    for report in recording.reports:
        start_ns = time.perf_counter_ns()
        digitizer.decode_report(report.data, round(report.time_s * 1e9))
        times_ns.append(time.perf_counter_ns() - start_ns)
    return _figures(times_ns)


def _terminal_us() -> tuple[float, float]:
    """Time from a write on one side until the other side can be read."""
    master, slave, _ = open_pseudo_terminal()
    late = []
    try:
        os.set_blocking(master, False)
        for _ in range(_WAKES):
            start_ns = time.monotonic_ns()
            os.write(slave, b"tactable")
            select.select([master], [], [])
            late.append(time.monotonic_ns() - start_ns)
            os.read(master, 64)
    finally:
        os.close(master)
        os.close(slave)
    return _figures(late)


def _figures(durations_ns: Sequence[int]) -> tuple[float, float]:
    found = Percentiles.of(durations_ns)
    assert found is not None  # each layer was measured many times
    return found.p50_ns / _US, found.p99_ns / _US
