"""The document of a report to one page that reads by itself, and to a summary in Markdown."""

import html
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tactable.bench.latency.stages import MISSES_MS, Values, us
from tactable.figures.style import BLUE, GREEN, GREY, VERMILLION

_COLOURS = (BLUE, VERMILLION, GREEN, GREY)
_WIDTH, _HEIGHT, _LEFT, _BOTTOM, _TOP = 640, 260, 60, 40, 12
_BINS = 80
_CSS = (
    "body{font:15px/1.5 sans-serif;max-width:70em;margin:2em auto;padding:0 1em;color:#222}"
    "table{border-collapse:collapse;margin:1em 0}td,th{padding:.2em .7em;border-bottom:1px solid #ddd;text-align:right}"
    "td:first-child,th:first-child{text-align:left}.note{color:#a40}svg{max-width:100%}pre{background:#f4f4f4;padding:1em}"
)


def page_html(document: Mapping[str, Any], ways_us: Mapping[str, Values]) -> str:
    """The whole page, nothing outside it; `ways_us` has the samples from due to written of each condition."""
    drawn = {name: values[np.isfinite(values)] for name, values in ways_us.items() if np.isfinite(values).any()}
    parts = ["<!doctype html><html lang=en><meta charset=utf-8><title>tactable: latency</title>"]
    parts.append(f"<style>{_CSS}</style><h1>From report to command</h1>")
    parts += [_html_of(block) for block in markdown_lines(document)]
    for load in dict.fromkeys(condition["load"] for condition in document["conditions"]):
        names = [c["name"] for c in document["conditions"] if c["load"] == load and c["name"] in drawn]
        for some in (names[i : i + len(_COLOURS)] for i in range(0, len(names), len(_COLOURS))):
            series = {name: drawn[name] for name in some}
            parts.append(f"<h2>{html.escape(load)}</h2>{svg_histogram(series)}{svg_exceedance(series)}")
    return "\n".join(parts) + "\n</html>\n"


def _html_of(block: str) -> str:
    """A block of our own Markdown: a heading, a table, a command or a paragraph."""
    if block.startswith("## "):
        return f"<h2>{html.escape(block[3:])}</h2>"
    if block.startswith("    "):
        return f"<pre>{html.escape(block.strip())}</pre>"
    if not block.startswith("| "):
        kind = " class=note" if "SIMULATED" in block else ""
        return f"<p{kind}>{html.escape(block)}</p>"
    head, _, *rows = ([html.escape(cell.strip()) for cell in row.strip("|").split("|")] for row in block.splitlines())
    lines = ["<tr>" + "".join(f"<th>{cell}" for cell in head)]
    lines += ["<tr>" + "".join(f"<td>{cell}" for cell in row) for row in rows]
    return "<table>" + "\n".join(lines) + "</table>"


def page_markdown(document: Mapping[str, Any]) -> str:
    """The summary."""
    return "\n\n".join(["# From report to command", *markdown_lines(document)]) + "\n"


def markdown_lines(document: Mapping[str, Any]) -> list[str]:
    """Blocks of Markdown: what was measured, on what, the figures, whom to blame, and how to do it again."""
    conditions = document["conditions"]
    blocks = [f"SIMULATED: {', '.join(document['simulated'])}."] if document["simulated"] else []
    whole = document["whole"]
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
    blocks += ["## Steps", *(f"- {line}" for line in _steps(conditions)), "## Machine", _machine(document)]
    return [*blocks, "## Again", f"    {document['command']}"]


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    return "\n".join(["| " + " | ".join(row) + " |" for row in (head, ["---"] * len(head), *rows)])


def _conditions_table(conditions: Sequence[Mapping[str, Any]], whole: str) -> str:
    keys = ("p50_us", "p90_us", "p99_us", "p99_9_us", "p99_99_us", "max_us", "jitter_us")
    rows = []
    for condition in conditions:
        figures = condition["stages"].get(whole, {})
        rows.append([condition["name"], str(figures.get("count", 0)), *(us(figures.get(key)) for key in keys)])
    return _table(["condition", "samples", "median", "p90", "p99", "p99.9", "p99.99", "max", "p90 - p10"], rows)


def _ratios_table(ratios: Sequence[Mapping[str, Any]]) -> str:
    rows = [
        [row["condition"], row["against"], row["way"], _interval(row["median"]), _interval(row["p99_9"])]
        for row in ratios
    ]
    return _table(["condition", "against", "way", "median ratio (95 %)", "p99.9 ratio (95 %)"], rows)


def _interval(found: Mapping[str, float] | None) -> str:
    return "too few samples" if found is None else f"{found['value']:.2f} ({found['low']:.2f} - {found['high']:.2f})"


def _stages_table(conditions: Sequence[Mapping[str, Any]]) -> str:
    names = list(dict.fromkeys(name for c in conditions for name in c["stages"] if " to " not in name))
    rows = []
    for condition in conditions:
        cells = [condition["stages"].get(name) for name in names]
        rows.append(
            [condition["name"], *("-" if c is None else f"{us(c['p50_us'])} / {us(c['p99_us'])}" for c in cells)]
        )
    return _table(["condition", *names], rows)


def _blames(conditions: Sequence[Mapping[str, Any]]) -> list[str]:
    lines = []
    for condition in conditions:
        found = condition["blame"]
        if found is not None:
            typical, slowest = found["typical"], found["slowest"]
            lines.append(
                f"{condition['name']}: mostly {typical['layer']} ({typical['stage']}, {100 * typical['share']:.0f} %); "
                f"the slowest hundredth lost its time in {slowest['layer']} ({slowest['stage']}, "
                f"{100 * slowest['share']:.0f} %)"
            )
    return lines


def _misses_table(conditions: Sequence[Mapping[str, Any]]) -> str:
    limits = [f"{limit} ms" for limit in MISSES_MS]
    rows = [[c["name"], *(str(c["misses"][limit]) for limit in limits)] for c in conditions]
    return _table(["condition", *(f"over {limit}" for limit in limits)], rows)


def _facts(conditions: Sequence[Mapping[str, Any]]) -> list[str]:
    lines = []
    for c in conditions:
        if "reports_lost" in c:
            order = {True: "order kept", False: "ORDER NOT KEPT", None: "order not judged: the watchdog released"}
            lines.append(
                f"{c['name']}: {c['reports_sent']} reports, {c['reports_lost']} lost, {c['commands']} commands, "
                f"{c.get('answered_by_fast_path', 0)} by the fast path, {c['replaced_unsent']} replaced unsent "
                f"by newer ones, {c['stale_sent']} stale ones sent, "
                f"{c['sessions_lost']} sessions lost, {order[c['order_kept']]}, "
                f"clocks within {c['clock_bounds_us']:.0f} us"
            )
    return lines


def _process_table(rows: Sequence[Mapping[str, Any]]) -> str:
    names = ("report_to_bytes", "report_to_answer", "of_one_finger", "of_ten_fingers")
    cells = []
    for row in rows:
        found = [row[name] or {} for name in names]
        figures = [f"{us(figures.get('p50_us'))} / {us(figures.get('p99_us'))}" for figures in found]
        cells.append([row["stream"], str(row["reports"]), *figures])
    head = ["stream", "reports", "to a command: median / p99", "until the loop is done", "one finger", "ten fingers"]
    return _table(head, cells)


def _comparison_table(comparison: Mapping[str, Any]) -> str:
    rows = []
    for name, found in comparison.items():
        stage = found.get("stage")
        cells = [
            f"{found[key]['ratio']:.2f} ({found[key]['low']:.2f} - {found[key]['high']:.2f}) {found[key]['verdict']}"
            for key in ("median", "p99")
        ]
        cells.append(
            "-" if stage is None else f"{stage['name']} ({stage['layer']}): {stage['median_change_us']:+.1f} us"
        )
        rows.append([name, *cells, f"{found['floor_ratio']:.2f}"])
    return _table(["condition", "median", "p99", "stage that changed most", "floor"], rows)


def _steps(conditions: Sequence[Mapping[str, Any]]) -> list[str]:
    found = {}
    for condition in conditions:
        for step in condition["steps"]:
            found[step["step"]] = f"{step['step']}: {step['finding']}" + (
                f"; {step['remedy']}" if step["remedy"] else ""
            )
    return list(found.values()) or ["none asked for"]


def _machine(document: Mapping[str, Any]) -> str:
    return _table(["what", "value"], [[str(k), str(v)] for k, v in _flat(document["environment"]).items()])


def _flat(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in values.items():
        flat |= _flat(value, f"{prefix}{key}.") if isinstance(value, Mapping) else {f"{prefix}{key}": value}
    return flat


# ---- drawings --------------------------------------------------------------------------------------------


def svg_histogram(series: Mapping[str, Values]) -> str:
    """Share of the samples in each of equal steps of the logarithm of time, us."""
    low, high = _range_of(series)
    edges = np.geomspace(low, high, _BINS + 1)
    counts = {name: np.histogram(values, edges)[0] / len(values) for name, values in series.items()}
    top = max(float(count.max()) for count in counts.values()) or 1.0
    lines = []
    for name, count in counts.items():
        points = [(x, share / top) for i, share in enumerate(count.tolist()) for x in (edges[i], edges[i + 1])]
        lines.append((name, points))
    ticks = [(share, f"{100 * share * top:.0f} %") for share in (0.0, 0.5, 1.0)]
    return _svg("histogram", lines, (low, high), ticks)


def svg_exceedance(series: Mapping[str, Values]) -> str:
    """Share of the samples that took longer, over time, us; both axes logarithmic."""
    low, high = _range_of(series)
    decades = max(1, math.ceil(math.log10(max(len(values) for values in series.values()))))
    lines = []
    for name, values in series.items():
        times = np.sort(values)
        count = len(values)
        beyond = 1 - np.arange(count) / count
        # Each power of ten in as many points as a screen shows.
        kept = count * (1 - np.geomspace(1, 1 / count, 200))
        places = np.unique(np.append(kept.astype(int), count - 1))
        heights = 1 + np.log10(beyond[places]) / decades
        lines.append((name, [*zip(times[places].tolist(), heights.tolist(), strict=True)]))
    ticks = [(1 - power / decades, "1" if not power else f"1e-{power}") for power in range(decades + 1)]
    return _svg("share that took longer", lines, (low, high), ticks)


def _range_of(series: Mapping[str, Values]) -> tuple[float, float]:
    low = max(0.1, min(float(values.min()) for values in series.values()))
    return low, max(1.01 * low, max(float(values.max()) for values in series.values()))


def _svg(
    title: str,
    lines: Sequence[tuple[str, Sequence[tuple[float, float]]]],
    range_us: tuple[float, float],
    ticks: Sequence[tuple[float, str]],
) -> str:
    """Lines over a logarithmic time axis; heights from 0 to 1."""
    low, high = map(math.log10, range_us)

    def place(time_us: float, height: float) -> tuple[float, float]:
        across = (math.log10(max(time_us, range_us[0])) - low) / (high - low)
        return _LEFT + across * (_WIDTH - _LEFT - 10), _HEIGHT - _BOTTOM - height * (_HEIGHT - _BOTTOM - _TOP)

    parts = [f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT + 18 * len(lines)}" role="img" aria-label="{title}" font-size="11">']
    for height, text in ticks:
        x, y = place(range_us[0], height)
        parts.append(f'<path d="M{x:.1f} {y:.1f}H{_WIDTH - 10}" stroke="#ddd"/>')
        parts.append(f'<text x="4" y="{y + 4:.1f}">{text}</text>')
    for power in range(math.ceil(low), math.floor(high) + 1):
        x, y = place(10.0**power, 0)
        parts.append(f'<path d="M{x:.1f} {_TOP}V{y:.1f}" stroke="#ddd"/>')
        parts.append(f'<text x="{x:.1f}" y="{y + 16:.1f}">{10.0**power:g}</text>')
    parts.append(f'<text x="{_WIDTH - 10}" y="{_HEIGHT - 8}" text-anchor="end">{title}, us</text>')
    for number, (name, points) in enumerate(lines):
        colour, y = _COLOURS[number % len(_COLOURS)], _HEIGHT + 18 * number + 4
        path = " ".join("{:.1f},{:.1f}".format(*place(*point)) for point in points)
        parts.append(f'<polyline fill="none" stroke="{colour}" stroke-width="1.5" points="{path}"/>')
        parts.append(f'<path d="M{_LEFT} {y}h20" stroke="{colour}" stroke-width="3"/>')
        parts.append(f'<text x="{_LEFT + 26}" y="{y + 4}">{html.escape(name)}</text>')
    return "\n".join([*parts, "</svg>"])
