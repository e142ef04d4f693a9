"""Command line: the table of all commands, and `main`, which runs one of them.

The help is printed from the table, and a command's module is imported only when that command is called, so that
`tactable --help` needs neither compiler nor solver. Every command is a plain function, whose annotations are its
options. All errors that a user can mend derive from `TactableError`; `main` prints them as one line.
"""

import io
import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Annotated, Any, NamedTuple

import typer
from typer import Option
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

from base.errors import TactableError
from tactable.kernel_cache import provide_kernel_cache, refuse_open_caches

EXIT_INTERRUPTED = 130  # the exit status is 128 plus the number of SIGINT, by convention
_SETTINGS = {"max_content_width": 120, "help_option_names": ["-h", "--help"]}


class Entry(NamedTuple):
    """A command as the help lists it: `target` is "module:function" under tactable/cli, or empty for a group.

    Where both names are the same it is given once.
    """

    target: str
    help: str


COMMANDS: Mapping[str, Mapping[str, Mapping[str, Entry]]] = {
    "": {
        "Set up": {
            "quickstart": Entry("quickstart", "Go from wiring to a felt click by questions, each step a command."),
            "list": Entry(
                "touch:list_devices", "List the touch digitizers, serial ports and sound cards of this machine."
            ),
            "doctor": Entry("touch:doctor", "Check whether touches can be read and commands written, and how fast."),
            "map": Entry("touch:map_axis", "Learn how the digitizer lies on the surface from strokes of a finger."),
            "record": Entry("touch:record", "Record what a digitizer reports."),
            "replay": Entry("touch:replay", "Decode a recording as the engine does, all at once."),
        },
        "Describe": {
            "new": Entry("new:new", "Write a device file for your bar or plate; what is not given is an estimate."),
            "check": Entry("device:check", "Validate a device file, and say what follows from it."),
            "modes": Entry("device:modes", "List the modes of a bar or a plate, untouched and under a finger."),
            "effects": Entry("", "Read effect files of other makers, and write them."),
        },
        "Build": {
            "build": Entry("build:build", "Build the table of a device."),
            "rollback": Entry("build:rollback", "Put the previous table back; a second rollback undoes the first."),
            "fleet": Entry("build:fleet", "Calibrate, build and verify many devices; an interrupted run continues."),
        },
        "Play": {
            "demo": Entry("demo:demo", "Show the whole chain, SIMULATED: as a page to touch, or as a report."),
            "run": Entry("run:run", "Play a table: turn touches into commands for the firmware."),
            "play": Entry("play:play", "Hold one drive by hand: a frequency, amplitude and phase for each actuator."),
            "emulate": Entry("demo:emulate", "Emulate the firmware on a serial port, SIMULATED."),
        },
        "Understand": {
            "explain": Entry("explain:explain", "Explain what is played for some fingers."),
            "diff": Entry("explain:diff", "Compare two tables, as a whole, row by row and click by click."),
            "export": Entry("explain:export", "Write a part of a table as NetCDF, CSV or MATLAB."),
            "plot": Entry("", "Draw what a table or a bar does: PNG, SVG or PDF, and the data as CSV."),
            "study": Entry("", "Search and compare bars that are not built yet: pictures and data."),
        },
        "Measure": {
            "plan-measurements": Entry("calibrate:plan_measurements", "Propose the readings that tell most."),
            "simulate-measurements": Entry("calibrate:simulate_measurements", "Write measurements, SIMULATED."),
            "measure": Entry(
                "measure", "Drive or tap a bar or plate and record its responses, for calibrate and build."
            ),
            "calibrate": Entry(
                "calibrate", "Fit a device to measured accelerations or modes, measured first if asked to."
            ),
            "experiment": Entry(
                "experiment", "Ask a person what is felt, trial by trial, to thresholds with intervals."
            ),
            "verify": Entry("verify", "Play drives and clicks of a table, and compare a sensor with the promise."),
            "bench": Entry("", "Measure speed on this machine, against floors measured beside it."),
        },
    },
    "plot": {
        "Pictures of a table": {
            "state": Entry("plot:state", "Draw a drive under some fingers: along the bar, or over time."),
            "factor": Entry("plot:factor", "Draw the localized factor over the frequencies of two actuators."),
            "click": Entry("plot:click", "Draw one click: its waveform and what each finger feels."),
        },
        "Pictures of a device": {
            "response": Entry("plot:response", "Draw the acceleration over the surface of one or more drives."),
            "optimum": Entry("plot:optimum", "Draw the drives of greatest localized factor of some zones."),
            "reach": Entry("plot:reach", "Draw the greatest acceleration and level of each place of the bar."),
        },
    },
    "effects": {
        "Effect files": {
            "show": Entry(
                "effects:show", "Read an effect file, say of each event whether it is played, draw or write it."
            ),
            "curve": Entry("effects:curve", "Write the greatest acceleration of places by frequency, as for Android."),
        }
    },
    "study": {
        "Studies": {
            "placement": Entry("plot:placement", "Search where actuators give the best worst contrast."),
            "resolution": Entry("plot:resolution", "Study how narrow zones can be with a number of actuators."),
            "robustness": Entry(
                "plot:robustness", "Study what clicks keep on bars and fingers that differ from the model."
            ),
        }
    },
    "bench": {
        "Benchmarks": {
            "sweep": Entry("bench:sweep", "Time the sweep over frequencies and amplitudes."),
            "step": Entry("bench:step", "Time the stages from a report to command bytes."),
            "control": Entry("bench:control", "Time a program's message to command bytes, beside touches."),
            "latency": Entry("bench:latency", "Measure the latency from report to command."),
        }
    },
}
"""Commands by group ("" is the top), then by section, in the order of the help."""


class CommandGroup(TyperGroup):
    """A group of `COMMANDS`: it lists the commands from the table, and imports the one that is called."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        sections = COMMANDS[self.name or ""].values()
        self.entries = {name: entry for section in sections for name, entry in section.items()}
        names: Any = dict.fromkeys(self.entries)
        self.commands = names  # typer suggests one of these where a name is misspelt
        self._is_listing = False

    def get_command(self, _ctx: Any, cmd_name: str) -> Any:
        """The command, its module imported; None where the table has no such name."""
        if self._is_listing:
            return TyperCommand(cmd_name, help=self.entries[cmd_name].help)
        return load_command(cmd_name, self.entries[cmd_name]) if cmd_name in self.entries else None

    def shell_complete(self, ctx: Any, incomplete: str) -> Any:
        """Names for a shell to complete; no module is imported for their help."""
        self._is_listing = True
        try:
            return super().shell_complete(ctx, incomplete)
        finally:
            self._is_listing = False

    def format_commands(self, _ctx: Any, formatter: Any) -> None:
        """Write the table's sections; nothing is imported for them."""
        for title, section in COMMANDS[self.name or ""].items():
            with formatter.section(title):
                formatter.write_dl([(name, entry.help) for name, entry in section.items()])


def _nothing() -> None:
    """The callback of a group of commands, which has no options."""


def _print_version(is_asked: bool) -> None:
    if is_asked:
        from importlib.metadata import version

        print(f"tactable {version('tactable')}")  # noqa: T201
        raise typer.Exit


def _top(
    version: Annotated[
        bool, Option("--version", callback=_print_version, is_eager=True, help="Print the version and end.")
    ] = False,
) -> None:
    """Options that precede every command."""


def _group(name: str, help_text: str, callback: Callable[..., None] = _nothing, completes: bool = False) -> typer.Typer:
    """A group of commands; the callback makes typer keep it a group although it knows none of its commands."""
    return typer.Typer(
        name=name,
        cls=CommandGroup,
        callback=callback,
        help=help_text,
        no_args_is_help=True,
        add_completion=completes,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,  # rich takes longer to start than all the rest of the help
        context_settings=dict(_SETTINGS),
    )


def load_command(name: str, entry: Entry) -> Any:
    """The command or group of an entry, its module imported."""
    if not entry.target:
        return get_command(_group(name, entry.help))
    module, _, function = entry.target.partition(":")
    single = typer.Typer(add_completion=False, rich_markup_mode=None, context_settings=dict(_SETTINGS))
    single.command(name)(getattr(import_module(f"tactable.cli.{module}"), function or module))
    return get_command(single)


app = _group("", "Localized touch feedback on touch bars, rendered from tables.", _top, completes=True)


def main() -> None:
    """Run the command. An error that a user can mend is one line and exit status 1, Ctrl-C is exit status 130."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # a terminal without ± shows its code in its place
    try:
        for note in (*refuse_open_caches(), provide_kernel_cache()):
            sys.stderr.write(f"tactable: {note}\n" if note else "")
        app(prog_name="tactable")
    except KeyboardInterrupt:
        sys.unraisablehook = lambda _: None  # after Ctrl-C the finalizers of half-closed objects fail
        raise SystemExit(EXIT_INTERRUPTED) from None
    except (TactableError, OSError) as error:
        from tactable.cli.console import print_error

        print_error(error)
        raise SystemExit(1) from None
