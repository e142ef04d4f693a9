"""The study of effect files counts every event of every file of a folder."""

from tactable.shipped import device_folder
from tests.studies.programs.effect_files import count


def test_the_shipped_files_are_counted() -> None:
    counted = count(device_folder().parent / "effects")
    assert {name: dict(counts) for name, counts in counted.items()} == {
        "ahap": {"files": 1, "kept": 3},
        "haptic": {"files": 1, "kept": 3, "changed": 2},
        "hjif": {"files": 1, "kept": 5},
    }
