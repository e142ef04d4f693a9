"""The options that the clicks of a table were made with, read without the rest of what made the table."""

import json
from dataclasses import fields
from typing import Any

from engine.table import Table, TableError
from precompute.clicks.click_options import DEFAULT_OPTIONS, ClickOptions


def read_click_options(table: Table) -> ClickOptions:
    """Read the attribute `click_options`. Raises TableError for options that this program does not know."""
    text = table.attributes.get("click_options")
    if text is None:
        return DEFAULT_OPTIONS
    values: dict[str, Any] = json.loads(str(text))
    unknown = sorted(set(values) - {field.name for field in fields(ClickOptions)})
    if unknown:
        raise TableError(f"{table.path}: its clicks have options unknown here: {', '.join(unknown)}; build it again")
    known: dict[str, Any] = {key: tuple(value) if isinstance(value, list) else value for key, value in values.items()}
    return ClickOptions(**known)
