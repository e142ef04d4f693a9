"""The command `bench latency`, whole: nothing is lost, order is kept, a stall is found in its layer, worse is said."""

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from engine.loop.realtime import Step
from tactable.bench.inputs import MOST_COMMANDS_HZ
from tactable.bench.latency.latency_report import LatencyReportError
from tactable.bench.latency.stages import STAGES
from tactable.cli.bench import EXIT_WORSE
from tactable.cli.main import app
from tactable.shipped import DEMO_RECORDING, find_device
from tests.engine.made_table import every_click, write_table

DEVICE = find_device("reference-a")
HAS_COMPILER = any(map(shutil.which, ("cc", "gcc", "clang")))
# As root of a busy machine: what else runs must be able to go on.
GENTLE = ("--realtime", "collector,switch-interval")


@pytest.fixture(autouse=True, scope="module")
def few_reports_in_process() -> Iterator[None]:
    """A hundredth of what the bench takes, where each run of it would repeat the same measurement for seconds."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tactable.bench.latency.latency_report._IN_PROCESS_REPORTS", 40)
        yield


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_table(tmp_path_factory.mktemp("bench") / "bar.nc", DEVICE, every_click(DEVICE))


def bench(folder: Path, *words: str) -> Result:
    return CliRunner().invoke(app, ["bench", "latency", *words, "-o", str(folder)], catch_exceptions=False)


def report(folder: Path, *words: str) -> dict[str, Any]:
    done = bench(folder, *words, "--json")
    assert done.exit_code == 0, done.output
    document: dict[str, Any] = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    assert json.loads(done.stdout)["conditions"] == document["conditions"]
    return document


def check_conditions(document: dict[str, Any]) -> None:
    """No report is lost, no command is stale, and order is kept."""
    ours = [condition for condition in document["conditions"] if condition["engine"] == "tactable"]
    assert [condition["rate_hz"] for condition in ours] == [200, 1000]
    for condition in ours:
        assert condition["reports_sent"] == 0.6 * condition["rate_hz"]
        assert (condition["reports_lost"], condition["stale_sent"]) == (0, 0)
        assert condition["order_kept"] or condition["released_by_watchdog"]
        assert condition["mispredicted"] == 0
        assert condition["answered_by_fast_path"] > 0 or not HAS_COMPILER  # all of them in process, below
        taps = condition["reports_sent"] / max(2, condition["rate_hz"] // MOST_COMMANDS_HZ)
        assert condition["commands"] + condition["replaced_unsent"] >= 0.9 * taps
        assert {step["step"] for step in condition["steps"]} == {Step.COLLECTOR, Step.SWITCH_INTERVAL}
        stages = condition["stages"]
        assert {"digitizer", "wake-up", "decode", "state", "look-up", "encode and write", "line"} <= stages.keys()
        assert 0 < stages["bar (simulated)"]["p50_us"] < 100_000  # the made clicks' 5 ms


def check_report(document: dict[str, Any], table: Path) -> None:
    """What a reader must know is in the report."""
    assert document["simulated"] == ["the touches", "the firmware"]
    assert document["table"]["device_fingerprint"] == DEVICE.fingerprint
    assert document["table"]["path"] == str(table)
    assert document["configuration"]["rates_hz"] == [200, 1000]
    assert document["environment"]["clock"]["reading_ns"] > 0
    assert {"processor", "governor", "clock_source", "virtual_machine"} <= document["environment"].keys()
    can_exchange = HAS_COMPILER and len(document["environment"]["allowed_processors"]) > 1
    assert len(document["environment"]["exchange_between_processors_ns"]) == 3 * can_exchange
    assert [row["stream"].split()[0] for row in document["in_process"]] == ["1", "2", "10"]
    assert all(row["report_to_bytes"]["count"] > 0 for row in document["in_process"])
    if HAS_COMPILER:
        one, two, ten = ((row["by_fast_path"], row["report_to_bytes"]["count"]) for row in document["in_process"])
        assert one[0] == one[1] > 0
        assert two[0] >= two[1] - 5 > 0  # the loop's own: a click that was cut is felt again
        assert ten[0] < ten[1]  # clicks of three fingers and more are in no table
        floors = [condition for condition in document["conditions"] if condition["engine"] == "C echo"]
        assert [(floor["rate_hz"], floor["commands"]) for floor in floors] == [(200, 60), (1000, 60)]
        medians = [row["median"] for row in document["ratios"]]
        assert len(medians) == 4
        assert all(median["low"] <= median["value"] <= median["high"] for median in medians)


@pytest.mark.machine
def test_nothing_is_lost_the_report_says_what_it_stands_on_and_slower_than_a_baseline_is_worse(
    table: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = tmp_path / "first"
    words = ("--loads", "idle", "--seconds", "0.3", "--rounds", "2", "--no-ablations", *GENTLE)
    with monkeypatch.context() as patch:
        patch.setattr("tactable.bench.latency.latency_report._IN_PROCESS_REPORTS", 400)
        document = report(first, str(table), "--rates", "200,1000", *words)
    check_conditions(document)
    check_report(document, table)
    assert len(document["conditions"]) == 2 + 2 * HAS_COMPILER
    with np.load(first / "samples.npz") as arrays:
        ours = {name: arrays[name] for name in arrays if not name.startswith("C echo")}
    faster = {name: each if "due" in name or name == "points" else each / 20 for name, each in ours.items()}
    (tmp_path / "report.json").write_bytes((first / "report.json").read_bytes())
    np.savez(tmp_path / "samples.npz", **faster)
    once = ("--loads", "idle", "--seconds", "0.3", "--rounds", "1", "--no-ablations", "--no-echo", *GENTLE)
    done = bench(tmp_path / "new", str(table), "--rates", "200", *once, "--compare", str(tmp_path / "report.json"))
    assert done.exit_code == EXIT_WORSE
    assert "WORSE than the baseline: tactable, 200/s" in done.stdout.replace("\n", " ")
    (found,) = json.loads((tmp_path / "new" / "report.json").read_text(encoding="utf-8"))["comparison"].values()
    assert found["median"]["low"] > 2
    assert found["stage"]["high_us"] > 0  # slower than the baseline; its other end is the machine's noise
    with pytest.raises(LatencyReportError, match="has none of these conditions"):
        bench(tmp_path / "others", str(table), "--rates", "300", *once, "--compare", str(first / "report.json"))


@pytest.mark.machine
def test_a_stall_of_the_host_is_found_and_nothing_stale_follows_it(table: Path, tmp_path: Path) -> None:
    words = ("--rates", "1000", "--loads", "idle", "--seconds", "1", "--rounds", "1", "--no-ablations", "--no-echo")
    (condition,) = report(tmp_path, str(table), *words, "--stall", "host", *GENTLE)["conditions"]
    assert condition["blame"]["slowest"]["layer"] == "host"
    slowest_us = [condition["stages"][stage.name]["max_us"] for stage in STAGES.values() if stage.layer == "host"]
    assert max(slowest_us) >= 50_000
    assert (condition["reports_lost"], condition["stale_sent"]) == (0, 0)
    # What came while the host stood still was replaced by what came last.
    assert condition["replaced_unsent"] >= 15
    assert condition["misses"]["5 ms"] > 0


@pytest.mark.machine
def test_a_recording_is_sent_at_the_stated_rate_and_over_a_terminal_the_firmware_says_when_it_had_a_command(
    table: Path, tmp_path: Path
) -> None:
    words = (str(table), "--rounds", "1", "--no-echo", "--realtime", "collector")
    recorded = ("--rates", "1000", "--loads", "thread", "--seconds", "0.7", "--recording", str(DEMO_RECORDING))
    document = report(tmp_path / "recorded", *words, *recorded)
    (condition,) = document["conditions"]
    assert (condition["reports_sent"], condition["reports_lost"]) == (700, 0)
    assert document["in_process"][-1]["reports"] == 692
    assert "SIMULATED" in (tmp_path / "recorded" / "report.md").read_text(encoding="utf-8")
    over = ("--over", "pty", "--rates", "200", "--loads", "idle", "--seconds", "0.5", "--no-ablations")
    document = report(tmp_path / "terminal", *words, *over)
    (condition,) = document["conditions"]
    assert condition["stages"]["line"]["count"] >= 0.9 * condition["commands"]
    assert condition["stages"]["device"]["count"] > 0
    assert condition["clock_bounds_us"] > 0
    assert document["ratios"] == []


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--loads", "busy"), "'busy' is not a valid BackgroundLoad"),
        (("--realtime", "nice"), "is unknown: write all, none"),
        (("--seconds", "700"), "take more --rounds"),
    ],
)
def test_what_cannot_be_measured_is_refused(table: Path, tmp_path: Path, words: tuple[str, str], said: str) -> None:
    done = bench(tmp_path, str(table), *words)
    assert done.exit_code == 2
    assert said in " ".join(done.output.replace("│", " ").split())
