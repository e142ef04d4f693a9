"""Turns the document of a report into a page in Markdown and its pictures."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from tactable.bench.latency.stages import MISSES_MS, Values, us
from tactable.figures.style import CURVES

_BINS = 80  # even in the logarithm: over three decades a bin is 9 % wide
_MOST_CURVES = 4


def page_pictures(document: Mapping[str, Any], ways_us: Mapping[str, Values]) -> dict[str, Figure]:
    """The pictures of a report by the names of their files; `ways_us`: from due to written by condition, us."""
    drawn = {name: values[np.isfinite(values)] for name, values in ways_us.items() if np.isfinite(values).any()}
    pictures = {}
    for load in dict.fromkeys(condition["load"] for condition in document["conditions"]):
        names = [c["name"] for c in document["conditions"] if c["load"] == load and c["name"] in drawn]
        for number, first in enumerate(range(0, len(names), _MOST_CURVES), 1):
            series = {name: drawn[name] for name in names[first : first + _MOST_CURVES]}
            pictures[f"{load}-{number}.png"] = draw_ways(series)
    return pictures


def draw_ways(series: Mapping[str, Values]) -> Figure:
    """Histogram of each series of latencies, us, and beside it the share that took longer; time is logarithmic."""
    low_us = max(0.1, min(float(values.min()) for values in series.values()))
    high_us = max(1.01 * low_us, max(float(values.max()) for values in series.values()))
    edges_us = np.geomspace(low_us, high_us, _BINS + 1)
    figure = Figure(figsize=(11, 4.2), layout="constrained")
    histogram, exceedance = figure.subplots(1, 2)
    for (name, values), (colour, line) in zip(series.items(), CURVES, strict=False):
        share = np.histogram(np.maximum(values, low_us), edges_us)[0] / len(values)
        histogram.stairs(100 * share, edges_us, color=colour, ls=line, label=name)
        beyond = 1 - np.arange(len(values)) / len(values)
        exceedance.step(np.sort(values), beyond, where="post", color=colour, ls=line)
    histogram.set(xscale="log", xlabel="due to written (us)", ylabel="share of the samples (%)")
    exceedance.set(xscale="log", yscale="log", xlabel="due to written (us)", ylabel="share that took longer")
    for axes in (histogram, exceedance):
        axes.set_xlim(low_us, high_us)
        axes.grid(visible=True, alpha=0.3)
    figure.legend(loc="outside lower center", ncols=2, fontsize="small")
    return figure


def page_markdown(document: Mapping[str, Any], pictures: Sequence[str]) -> str:
    """The page in Markdown, with the names of its pictures."""
    shown = [f"![distribution of the latency]({name})" for name in pictures]
    return "\n\n".join(["# From report to command", *markdown_lines(document), *shown]) + "\n"


def markdown_lines(document: Mapping[str, Any]) -> list[str]:
    """Blocks of Markdown: what was measured, the figures, the layers to blame, the machine, and the command."""
    conditions = document["conditions"]
    blocks = [f"SIMULATED: {', '.join(document['simulated'])}."] if document["simulated"] else []
    whole = document["whole"]
    if "finger_waits" in document:
        blocks.append(f"Touch to felt click: {document['finger_waits']}.")
    blocks += [document["method"], f"## {whole.capitalize()}, us", _conditions_table(conditions, whole)]
    if document["ratios"]:
        blocks += ["## Against what the system costs", document["floor_note"], _ratios_table(document["ratios"])]
    elif document["floor_note"]:
        blocks.append(document["floor_note"])
    blocks += ["## Stages, median and p99 in us", _stages_table(conditions)]
    blocks += [f"- {line}" for line in _blames(conditions)]
    blocks += ["## What came late", _misses_table(conditions)]
    blocks += [f"- {line}" for line in _facts(conditions)]
    if document.get("in_process"):
        blocks += ["## Inside the process, us, no system call", _process_table(document["in_process"])]
    if document.get("comparison"):
        blocks += ["## Against the baseline", _comparison_table(document["comparison"])]
    machine = [[str(key), str(value)] for key, value in _flat(document["environment"]).items()]
    blocks += ["## Steps", *(f"- {line}" for line in _steps(conditions))]
    blocks += ["## Machine", _table(["what", "value"], machine)]
    return [*blocks, "## Again", f"    {document['command']}"]


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    return "\n".join(["| " + " | ".join(row) + " |" for row in (head, ["---"] * len(head), *rows)])


def _conditions_table(conditions: Sequence[Mapping[str, Any]], whole: str) -> str:
    keys = ("p50_us", "p90_us", "p99_us", "p99_9_us", "p99_99_us", "max_us", "jitter_us")
    figures = [(condition["name"], condition["stages"].get(whole, {})) for condition in conditions]
    rows = [[name, str(each.get("count", 0)), *(us(each.get(key)) for key in keys)] for name, each in figures]
    return _table(["condition", "samples", "median", "p90", "p99", "p99.9", "p99.99", "max", "p90 - p10"], rows)


def _ratios_table(ratios: Sequence[Mapping[str, Any]]) -> str:
    rows = [
        [row["condition"], row["against"], row["way"], _interval(row["median"]), _interval(row["p99_9"])]
        for row in ratios
    ]
    return _table(["condition", "against", "way", "median ratio (95 %)", "p99.9 ratio (95 %)"], rows)


def _interval(found: Mapping[str, float] | None, key: str = "value") -> str:
    return "too few samples" if found is None else f"{found[key]:.2f} ({found['low']:.2f} - {found['high']:.2f})"


def _median_and_p99(figures: Mapping[str, float | None] | None) -> str:
    return "-" if figures is None else f"{us(figures['p50_us'])} / {us(figures['p99_us'])}"


def _stages_table(conditions: Sequence[Mapping[str, Any]]) -> str:
    names = list(dict.fromkeys(name for c in conditions for name in c["stages"] if " to " not in name))
    return _table(
        ["condition", *names],
        [[c["name"], *(_median_and_p99(c["stages"].get(name)) for name in names)] for c in conditions],
    )


def _blames(conditions: Sequence[Mapping[str, Any]]) -> list[str]:
    def named(found: Mapping[str, Any]) -> str:
        return f"{found['layer']} ({found['stage']}, {100 * found['share']:.0f} %)"

    blamed = [(c["name"], c["blame"]) for c in conditions if c["blame"] is not None]
    return [
        f"{name}: mostly {named(blame['typical'])}; the slowest hundredth lost its time in {named(blame['slowest'])}"
        for name, blame in blamed
    ]


def _misses_table(conditions: Sequence[Mapping[str, Any]]) -> str:
    limits = [f"{limit} ms" for limit in MISSES_MS]
    rows = [[c["name"], *(str(c["misses"][limit]) for limit in limits)] for c in conditions]
    return _table(["condition", *(f"over {limit}" for limit in limits)], rows)


def _facts(conditions: Sequence[Mapping[str, Any]]) -> list[str]:
    order = {True: "order kept", False: "ORDER NOT KEPT", None: "order not judged: the watchdog released"}
    return [
        f"{c['name']}: {c['reports_sent']} reports, {c['reports_lost']} lost, {c['commands']} commands, "
        f"{c.get('answered_by_fast_path', 0)} by the fast path, {c['replaced_unsent']} replaced unsent "
        f"by newer ones, {c['stale_sent']} stale ones sent, {c['sessions_lost']} sessions lost, "
        f"{order[c['order_kept']]}, clocks within {c['clock_bounds_us']:.0f} us"
        for c in conditions
        if "reports_lost" in c
    ]


def _process_table(rows: Sequence[Mapping[str, Any]]) -> str:
    names = ("report_to_bytes", "report_to_answer", "of_one_finger", "of_ten_fingers")
    head = ["stream", "reports", "to a command: median / p99", "until the loop is done", "one finger", "ten fingers"]
    return _table(head, [[r["stream"], str(r["reports"]), *(_median_and_p99(r[name]) for name in names)] for r in rows])


def _comparison_table(comparison: Mapping[str, Any]) -> str:
    rows = []
    for name, found in comparison.items():
        verdicts = [f"{_interval(found[key], 'ratio')} {found[key]['verdict']}" for key in ("median", "p99")]
        stage = found.get("stage")
        changed = f"{stage['name']} ({stage['layer']}): {stage['median_change_us']:+.1f} us" if stage else "-"
        rows.append([name, *verdicts, changed, f"{found['floor_ratio']:.2f}"])
    return _table(["condition", "median", "p99", "stage that changed most", "floor"], rows)


def _steps(conditions: Sequence[Mapping[str, Any]]) -> list[str]:
    steps = {step["step"]: step for condition in conditions for step in condition["steps"]}
    lines = [f"{s['step']}: {s['finding']}" + (f"; {s['remedy']}" if s["remedy"] else "") for s in steps.values()]
    return lines or ["none asked for"]


def _flat(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in values.items():
        flat |= _flat(value, f"{prefix}{key}.") if isinstance(value, Mapping) else {f"{prefix}{key}": value}
    return flat
