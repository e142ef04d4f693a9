"""The file formats of a fleet: what any table of theirs is read with."""

from pathlib import Path

from engine.device.toml_table import TomlTable
from precompute.fleet.error import FleetError


class ManifestSection(TomlTable):
    """A table of a manifest or a study; files it names are relative to `folder`."""

    family = FleetError

    def file(self, key: str, folder: Path) -> Path:
        """A file by its name, there or not: one that is missing is the unit's trouble, not the fleet's."""
        value = self.take(key)
        if not isinstance(value, str) or not value:
            raise self.error(key, value, "expected the name of a file")
        return folder / value
