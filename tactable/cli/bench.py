"""Commands `bench ...`: each runs one benchmark, and prints its page or its JSON."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Option

from engine.loop.realtime import Step, parse_steps
from engine.table import Table
from engine.touch.sources.recording import read_recording
from tactable.bench.inputs import MOST_COMMANDS_HZ, Stream, open_table, replayed, tapping
from tactable.bench.latency.compare import got_worse
from tactable.bench.latency.conditions import PTY_BIT_RATE_HZ, BackgroundLoad, Plan, Transport
from tactable.bench.latency.load_generator import Stall, StalledLayer
from tactable.bench.latency.stages import us
from tactable.cli.console import ERRORS, OUT, remark, say, show
from tactable.cli.options import AsJson, BitRate, DeviceOption, OptionalTable, OptionError, read_counts
from tactable.shipped import DEMO_RECORDING, find_device, named_effects

EXIT_WORSE = 4
_HIGHEST_RATE_HZ = 20_000
_MOST_SAMPLES = 65_536  # what the engine keeps (engine/loop/observer.py)


def sweep(device_name: DeviceOption = "reference-a", as_json: AsJson = False) -> None:
    """Time the sweep over frequencies and amplitudes.

    It is compared with NumPy, with the solution point by point, and with the time to write the same memory.
    """
    from tactable.bench.sweep import print_sweep_bench, run_sweep_bench

    show(run_sweep_bench(find_device(device_name)), as_json, print_sweep_bench)


def step(
    table_path: OptionalTable = None,
    recordings: Annotated[
        list[Path] | None, Option("--recording", help="In hid-recorder format; default: the shipped one.")
    ] = None,
    rules_path: Annotated[
        Path | None, Option("--rules", help="Also with the rules of this file, such as tables/effects/slider.toml.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Time the stages from a report to command bytes.

    Drives for positions and for zones, and clicks are timed, with and without rules, beside the compiled step.
    """
    from engine.effects.rule_file import read_effects
    from tactable.bench.step import RULES, print_step_bench, run_step_bench

    read = {path.name: read_recording(path) for path in recordings or [DEMO_RECORDING]}
    with open_table(table_path) as table:
        rules = dict(RULES)
        if rules_path is not None:
            rules[rules_path.name] = read_effects(rules_path, table.device, named_effects())
        show(run_step_bench(table, read, rules), as_json, print_step_bench)


def control(
    table_path: OptionalTable = None,
    rounds: Annotated[int, Option(min=10, help="Touches and messages of each kind.")] = 1000,
    as_json: AsJson = False,
) -> None:
    """Time a program's message to command bytes, beside touches.

    Messages of a program and touches take turns in the same run, and bring the same clicks. A pause follows
    each click: 1000 rounds, with the compiled step and then without, pause for two and a half minutes in all.
    """
    from tactable.bench.control_bench import print_control_bench, run_control_bench

    with open_table(table_path) as table:
        show(run_control_bench(table, rounds), as_json, print_control_bench)


def latency(
    table_path: OptionalTable = None,
    rates: Annotated[str, Option(help="Reports a second, rising.")] = "125,1000,4000",
    fingers: Annotated[int, Option(min=1, max=10, help="Generated fingers; one of them taps.")] = 1,
    recordings: Annotated[
        list[Path] | None,
        Option("--recording", help="Send the reports of this recording; further ones inside the process only."),
    ] = None,
    over: Annotated[
        str, Option(metavar="sockets|pty|PORT", help="Engine alone, an emulator behind a terminal, or a serial port.")
    ] = "sockets",
    bit_rate_hz: BitRate = PTY_BIT_RATE_HZ,
    loads: Annotated[str, Option(help="Background loads, of idle, stress and thread.")] = "idle,stress,thread",
    real_time: Annotated[
        str, Option("--realtime", help="Real-time steps as `run` takes them: all, none, all,-priority.")
    ] = "all",
    ablations: Annotated[bool, Option(help="Measure also without each step, without all, and zones.")] = True,
    echo: Annotated[bool, Option(help="Measure also the C echo engine, where a compiler is there.")] = True,
    stall: Annotated[StalledLayer | None, Option(help="Let a layer stand still 60 of 250 ms, to see it named.")] = None,
    seconds: Annotated[float, Option(min=0.05, help="Length of a segment of measurement.")] = 1.0,
    rounds: Annotated[int, Option(min=1, help="Segments of each condition, interleaved.")] = 5,
    output: Annotated[Path, Option("-o", "--output", help="Folder of the report.")] = Path("latency"),
    baseline: Annotated[
        Path | None, Option("--compare", help="An earlier report.json; exit status 4 if latency got worse.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Measure the latency from report to command.

    The report says where each microsecond goes, with tails, beside loads and floors. Exit status 4: it is worse
    than the report of --compare.
    """
    # It draws, and knows the demo: importing that takes longer than parsing the options.
    from base.plain import to_plain
    from tactable.audio.names import is_audio
    from tactable.bench.latency.latency_report import compare_with, measure, read_baseline, write_report

    if is_audio(over):
        raise OptionError(
            f"--over {over}: a sound card takes no part in this benchmark, since its buffers of 5 to 20 ms are the "
            "latency; measure it with `tactable measure`, which states it, or give a serial port"
        )
    with open_table(table_path) as table:
        streams = _streams(table, read_counts("--rates", rates, 1, _HIGHEST_RATE_HZ), fingers, recordings or [])
        transport = Transport(over) if over == "sockets" else Transport(over, bit_rate_hz)
        plan = _plan(tuple(rate for rate, _ in streams), loads, real_time, ablations, echo, bool(table.best_rows))
        most_hz = plan.rates_hz[-1] if recordings else min(plan.rates_hz[-1], MOST_COMMANDS_HZ)
        if most_hz * seconds > _MOST_SAMPLES:
            longest_s = _MOST_SAMPLES // most_hz
            raise typer.BadParameter(f"--seconds {seconds:g}: at most {longest_s} at this rate; take more --rounds")
        injected = None if stall is None else Stall(stall)
        before = None if baseline is None else read_baseline(baseline, plan)
        document, run = measure(
            table, plan, streams, recordings or [], transport, seconds, rounds, injected, _on_progress
        )
    if before is not None:
        document["comparison"] = to_plain(compare_with(run, before))
    document["finger_waits"] = _finger_waits(document, bit_rate_hz)
    write_report(document, run, output)
    show(document, as_json, lambda _, found: _print_summary(found, output))
    if got_worse(document.get("comparison", {})):
        raise typer.Exit(EXIT_WORSE)


def _finger_waits(document: dict[str, Any], bit_rate_hz: int) -> str:
    """What a finger waits for with the engine at the lowest rate, of the first background load."""
    from tactable.doctor.layers import wait_text

    first = document["conditions"][0]
    panel = 1e3 / first["rate_hz"], f"computed: the next frame of {first['rate_hz']} a second"
    engine_ms = first["stages"][document["whole"]]["p50_us"] / 1e3
    return wait_text(
        panel, (engine_ms, f"measured: {first['name']}, median"), bit_rate_hz, Path(document["table"]["path"])
    )


def _streams(table: Table, rates: Sequence[int], fingers: int, recordings: Sequence[Path]) -> list[tuple[int, Stream]]:
    if recordings:
        stream = replayed(read_recording(recordings[0]))
        return [(rate_hz, stream) for rate_hz in rates]
    return [(rate_hz, tapping(fingers, rate_hz, table.device)) for rate_hz in rates]


def _plan(rates: tuple[int, ...], loads: str, steps: str, ablates: bool, echo: bool, has_zones: bool) -> Plan:
    try:
        chosen: tuple[Step, ...] = parse_steps(steps)
        beside = tuple(BackgroundLoad(part.strip()) for part in loads.split(",") if part.strip())
    except ValueError as error:
        raise typer.BadParameter(str(error)) from error
    if not beside:
        raise typer.BadParameter(f"--loads {loads!r}: expected some of {', '.join(BackgroundLoad)}")
    return Plan(rates, beside, chosen, has_echo=echo, ablates=ablates, has_zones=has_zones)


def _on_progress(text: str) -> None:
    if ERRORS.is_terminal:
        remark(text, "dim")


def _print_summary(document: dict[str, Any], folder: Path) -> None:
    say(f"touch to felt click: {document['finger_waits']}")
    if document["simulated"]:
        say(f"SIMULATED: {', '.join(document['simulated'])}")
    for condition in document["conditions"]:
        figures = condition["stages"].get(document["whole"])
        if figures is not None:
            shown = {"median": "p50_us", "p99": "p99_us", "greatest": "max_us"}
            text = ", ".join(f"{name} {us(figures[key])} us" for name, key in shown.items())
            say(f"{condition['name']}: {text} of {figures['count']}")
        if condition["blame"] is not None:
            slowest = condition["blame"]["slowest"]
            say(f"  its slowest lost their time in {slowest['layer']} ({slowest['stage']})")
    for row in document["ratios"]:
        if row["way"].startswith("due"):
            say(f"{row['condition']}, against {row['against']}: median {row['median']['value']:.2f}")
    for name in got_worse(document.get("comparison", {})):
        OUT.print(f"WORSE than the baseline: {name}", style="red", soft_wrap=True)
    say(f"{folder / 'report.md'}: the page; pictures, report.json and the samples beside it")
