"""Entries of states that no table holds, solved on demand and kept in a folder."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from engine.files import replace_file
from engine.table import Entry, Table
from engine.table.entry import EntrySpread, Percentiles, WorstCase, ZonePrediction
from engine.touch import ZoneState, state_index
from precompute.builder.code_fingerprint import code_fingerprint
from precompute.builder.measured_responses import plant_of
from precompute.entries.prediction import MadeFor, States
from precompute.entries.solver import EntrySolver


def entries_on_demand(table: Table, states: States, folder: Path) -> list[Entry]:
    """The entries of any state of the table's device, one a tabulated level: the table's own, or solved and kept.

    What `folder` holds of another device, code, objective or measurement has another name and is not looked at.
    """
    index, objective = state_index(states), str(table.attributes["objective"])
    own = [entry for level_db in table.levels_db if (entry := table.entry_at(index, level_db)) is not None]
    if own:
        return own
    made_for = MadeFor(str(table.attributes.get("made_for", MadeFor.MEAN)))
    source = str(table.attributes.get("responses_sha256", "model"))[:16]
    made = f"{source}-{code_fingerprint()[:16]}-{objective.replace(' ', '-')}-{made_for}"
    name = f"{table.fingerprint[:16]}-{made}-{index}.json"
    path = folder / name
    if path.is_file():
        return [_entry_of(values) for values in json.loads(path.read_text(encoding="utf-8"))]
    with threadpool_limits(1, "blas"):
        entries = EntrySolver(plant_of(table), objective, made_for).solve(states)
    folder.mkdir(parents=True, exist_ok=True)
    with replace_file(path) as partial:
        partial.write_text(json.dumps([asdict(entry) for entry in entries]), encoding="utf-8")
    return entries


def _entry_of(values: dict[str, Any]) -> Entry:
    zones = tuple(
        ZonePrediction(**{**_tuples(zone), "state": ZoneState(zone["state"])}) for zone in values.pop("zones")
    )
    worst_case = WorstCase(**values.pop("worst_case"))
    found = values.pop("spread").items()
    spread: dict[str, Any] = {key: None if ends is None else Percentiles(**ends) for key, ends in found}
    return Entry(**_tuples(values), zones=zones, worst_case=worst_case, spread=EntrySpread(**spread))


def _tuples(values: dict[str, Any]) -> dict[str, Any]:
    return {key: tuple(value) if isinstance(value, list) else value for key, value in values.items()}
