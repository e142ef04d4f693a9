"""What is kept of the events of effect files in a folder: counts by format and fate.

    python -m tests.studies.programs.effect_files FOLDER

docs/results.md has the figures for the public files in `SOURCES`, which are not part of this repository: put them
into a folder under these names. Each was read as stored in a public index in November 2026; the curves of the
frequency of CanDrop, Keyboard and Knife, which are not kept anyway, were shortened.
"""

import json
from collections import Counter
from pathlib import Path

from engine.effects.files.conversion import FORMATS, FULL_LEVEL_DB, read_effect_file
from tests.studies.options import read_options

_MPEG = "github.com/MPEGGroup/HapticReferenceSoftware"
_STUDIO = "github.com/htw128/haptics-studio, a copy of Meta's, companion/quest/Assets"
_HAPTRIX = "github.com/nthState/Haptrix Samples"
SOURCES = {
    "Boing.ahap": f"{_HAPTRIX}/Boing.ahap",
    "Oscillate.ahap": f"{_HAPTRIX}/Oscillate.ahap at 74aefcb9",
    "revEngine.ahap": f"{_HAPTRIX}/revEngine.ahap at 8e9492ea",
    "test.ahap": f"{_MPEG} ReferenceFiles/test.ahap at 3642bba9",
    "Button_Hover_A.haptic": f"{_STUDIO}/HapticClips at f0ed0c97",
    "Button_Press_Default_A.haptic": f"{_STUDIO}/HapticClips at f0ed0c97",
    "CanDrop.haptic": f"{_STUDIO}/Resources/SampleProject/00425833... at f0ed0c97",
    "Keyboard.haptic": f"{_STUDIO}/Resources/SampleProject/13eaa982... at f0ed0c97",
    "Knife.haptic": f"{_STUDIO}/Resources/SampleProject/0526d539... at f0ed0c97",
    "boing.hjif": f"{_MPEG} scripts/RM_submission/out/Test1_1/HJIF/Test1-1fvt_5_vib_16_boing.hjif at 27f9babb",
    "DoubleTick.hjif": f"{_MPEG} .../Test1_1/HJIF/Test1-1fvt_0_vib_2_DoubleTick.hjif at a216e059",
    "FastPulse1.hjif": f"{_MPEG} .../Test1_1/HJIF/Test1-1fvt_0_vib_64_FastPulse1.hjif at a216e059",
    "Fill1.hjif": f"{_MPEG} .../Test1_1/HJIF/Test1-1fvt_0_vib_2_Fill1.hjif at a216e059",
    "Grain1.hjif": f"{_MPEG} .../Test1_1/HJIF/Test1-1fvt_0_vib_2_Grain1.hjif at a216e059",
    "Tick1.hjif": f"{_MPEG} .../Test1_1/HJIF/Test1-1fvt_0_vib_16_Tick1.hjif at a216e059",
    "heartbeats.hjif": f"{_MPEG} .../Test1_2/HJIF/Test1-2fvt_0_vib_64_heartbeats.hjif at a216e059",
    "inflate.hjif": f"{_MPEG} .../Test1_2/HJIF/Test1-2fvt_0_vib_2_inflate.hjif at a216e059",
    "oscillate.hjif": f"{_MPEG} .../Test1_2/HJIF/Test1-2fvt_0_vib_2_oscillate.hjif at a216e059",
}


def count(folder: Path) -> dict[str, Counter[str]]:
    """Events by fate, and files, by format. Raises EffectError for a file that is not valid."""
    counted: dict[str, Counter[str]] = {file_format: Counter() for file_format in FORMATS}
    for path in sorted(folder.iterdir()):
        if (file_format := path.suffix.removeprefix(".")) in FORMATS:
            converted = read_effect_file(path, path.stem, FULL_LEVEL_DB)
            counted[file_format]["files"] += 1
            counted[file_format].update(str(report.fate) for report in converted.reports)
    return counted


def main() -> None:
    """Read the options, count, and print."""
    print(json.dumps(count(read_options(__doc__, folder=Path).folder), indent=2))


if __name__ == "__main__":
    main()
