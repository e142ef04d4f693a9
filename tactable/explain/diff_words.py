"""Comparison of two tables, as a page or as JSON."""

from dataclasses import asdict
from functools import partial
from typing import Any

from rich.console import Console
from rich.table import Table as Grid
from rich.text import Text

from base.plain import to_plain
from engine.device.values import Change, Value, number_of
from engine.table.table_diff import FigureChange, PartDiff, StateChange, TableDiff, describe
from tactable.explain.words import print_lines

_SHOWN, _FIGURES, _NAMED, _LONGEST = 8, 3, 3, 40  # a screen's worth; --json has all
_UNCERTAINTY = "uncertainty."
_UNIT_OF = {"db": "dB", "hz": "Hz", "rad": "rad", "s": "s"}


def diff_json(found: TableDiff) -> dict[str, Any]:
    """The comparison as plain values for JSON, which has no infinite numbers: they become None."""
    tolerance = found.tolerance
    changes = {key: getattr(found, key) for key in ("device", "options", "provenance")}
    return to_plain(
        {
            **{key: getattr(found, key) for key in ("differs", "notes", "response_percent", "arrays")},
            **{key: [{**asdict(each), "percent": each.percent} for each in part] for key, part in changes.items()},
            "limit": {"level_db": tolerance.level_db, "percent": 100 * tolerance.ratio},
            "best_rows": _part_json(found.best_rows),
            "clicks": _part_json(found.clicks),
        }
    )


def short_diff_json(found: TableDiff) -> dict[str, Any]:
    """The comparison with the number of changed states in place of the states."""
    whole = diff_json(found)
    return whole | {part: whole[part] | {"changed": len(whole[part]["changed"])} for part in ("best_rows", "clicks")}


def _part_json(part: PartDiff) -> dict[str, Any]:
    return {
        "compared": part.compared,
        "largest": [
            {"count": count, **_state_json(state), **_figure_json(figure)} for count, state, figure in part.largest()
        ],
        "changed": [
            {**_state_json(state), "figures": [_figure_json(figure) for figure in state.figures]}
            for state in part.changed
        ],
        "vanished": part.vanished,
        "appeared": part.appeared,
    }


def _state_json(state: StateChange) -> dict[str, Any]:
    return {"felt": state.felt, "quiet": state.quiet, "level_db": state.level_db}


def _figure_json(figure: FigureChange) -> dict[str, Any]:
    return {**asdict(figure), "unit": figure.unit}


def print_diff(out: Console, found: TableDiff) -> None:
    """Print whether the tables differ, then device and provenance, then the figures that changed most."""
    say = partial(print_lines, out)
    tolerance = found.tolerance
    limit = f"beyond {tolerance.level_db:g} dB, {100 * tolerance.ratio:.2g} % and a step of frequency"
    say(f"the tables {'differ' if found.differs else f'are the same: nothing changed {limit}'}")
    for note in found.notes:
        say(note)
    for title, changes in (("device", found.device), ("option", found.options), ("made", found.provenance)):
        for change in changes:
            say(f"{title}: {_change_text(change)}")
    for name, percent in found.response_percent.items():
        say(f"response of {name}: changed by up to {percent:.3g} % of its greatest")
    if found.arrays:
        say(f"other arrays that are not the same: {', '.join(found.arrays)}")
    for title, part in (("best rows", found.best_rows), ("clicks", found.clicks)):
        _print_part(out, title, part, limit)


def print_short_diff(out: Console, found: TableDiff) -> None:
    """Print what changed in the device, and for each figure of best rows and clicks where it changed most."""
    say = partial(print_lines, out)
    for change in found.device:
        if not change.key.startswith(_UNCERTAINTY):
            say(f"device: {_change_text(change)}")
    for title, part in (("best rows", found.best_rows), ("clicks", found.clicks)):
        if part.compared:
            say(f"{title}: {len(part.changed)} of {part.compared} changed")
            _print_largest(out, part)


def _change_text(change: Change) -> str:
    if change.before is None:
        return f"{change.key}: {_text(change.after)} appeared"
    if change.after is None:
        return f"{change.key}: {_text(change.before)} vanished"
    percent = "" if change.percent is None else f" ({change.percent:+.3g} %)"
    return f"{change.key}: {_text(change.before)} -> {_text(change.after)}{percent}"


def _text(value: Value, digits: int = 6) -> str:
    if value is None:
        return "none"
    number = number_of(value)
    return str(value)[:_LONGEST] if number is None else f"{number:.{digits}g}"


def _print_part(out: Console, title: str, part: PartDiff, limit: str) -> None:
    say = partial(print_lines, out)
    for states, what in ((part.vanished, "vanished"), (part.appeared, "appeared")):
        if states:
            more = f" and {len(states) - _NAMED} more" if len(states) > _NAMED else ""
            say(f"{title}: {len(states)} {what}: {'; '.join(states[:_NAMED])}{more}")
    if not part.changed:
        say(
            f"{title}: none of {part.compared} changed"
            if part.compared
            else f"{title}: both tables have none in common"
        )
        return
    say(f"{title}: {len(part.changed)} of {part.compared} changed {limit}; each figure where it changed most:")
    _print_largest(out, part)
    say(f"the {min(_SHOWN, len(part.changed))} that changed most:")
    for state in part.changed[:_SHOWN]:
        figures = sorted(state.figures, key=lambda f: (f.unit == "", f.unit == "dB", f.size), reverse=True)
        texts = (
            f"{_named(f.figure)[0]} {_text(f.before, 3)} -> {_text(f.after, 3)}{_unit(f)}" for f in figures[:_FIGURES]
        )
        say(f"  {describe(state.felt, state.quiet, state.level_db)}: {', '.join(texts)}")


def _print_largest(out: Console, part: PartDiff) -> None:
    if not part.changed:
        return
    largest = Grid("figure", "changed", "before", "after", "where it changed most")
    for count, state, figure in part.largest():
        words, _ = _named(figure.figure)
        where = Text(describe(state.felt, state.quiet, state.level_db))
        largest.add_row(words, str(count), _text(figure.before), _text(figure.after) + _unit(figure), where)
    out.print(largest)


def _named(figure: str) -> tuple[str, str]:
    """A figure in words, and the unit of its values."""
    ending = figure.rpartition("_")[2]
    if ending not in _UNIT_OF:
        return figure.replace("_", " "), ""
    return figure.removesuffix(f"_{ending}").replace("_", " "), _UNIT_OF[ending]


def _unit(figure: FigureChange) -> str:
    unit = "%" if figure.figure == "waveform" else _named(figure.figure)[1]
    return f" {unit}" if unit else ""
