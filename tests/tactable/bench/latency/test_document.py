"""What docs/latency.md says of commands and stages is what the program has."""

import re
import shlex
from pathlib import Path

from tactable.bench.latency.stages import STAGES
from tactable.cli.main import COMMANDS, load_command

TEXT = (Path(__file__).parents[4] / "docs" / "latency.md").read_text(encoding="utf-8")


def test_every_option_that_it_shows_exists() -> None:
    parameters = load_command("latency", COMMANDS["bench"]["Benchmarks"]["latency"]).params
    known = {option for parameter in parameters for option in (*parameter.opts, *parameter.secondary_opts)}
    lines = [line for line in TEXT.splitlines() if line.startswith("tactable bench latency")]
    shown = {word for line in lines for word in shlex.split(line, comments=True) if word.startswith("-")}
    assert len(lines) >= 6
    assert shown <= known


def test_it_names_every_stage_with_its_layer() -> None:
    rows = dict(re.findall(r"^\| ([a-z() -]+) \| .* \| (\w+)[^|]* \|$", TEXT, re.MULTILINE))
    assert {stage.name: stage.layer for stage in STAGES.values()}.items() <= rows.items()
