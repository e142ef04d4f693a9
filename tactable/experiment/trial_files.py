"""The files of a session: one row of CSV for each trial, written at once, and a JSON file that explains every column.

Names and keys follow the Brain Imaging Data Structure as far as it has words for this (sub-01_task-NAME_beh). A row is
flushed to the disk before the next trial, so that a lost machine loses none; of half a row at the end nothing is kept.
"""

import csv
import io
import json
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

from base.files import write_text
from base.plain import to_plain
from engine.device import Device
from tactable.experiment.protocol import ExperimentError, Protocol
from tactable.experiment.session import Role, Session, Trial

COLUMNS: Mapping[str, tuple[str, str]] = {
    "trial": ("", "number of the trial in the session, from 1"),
    "task": ("", "name of the task in the protocol"),
    "kind": ("", "what the task asks"),
    "role": ("", "practice, test or catch; a catch trial is without the stimulus that is asked about"),
    "finger": ("", "finger that the trial is about: 0 left or only, 1 right"),
    "side": ("", "index of the right answer among the choices"),
    "level_db": ("dB", "level above the device's threshold that was asked for; of a discrimination the difference"),
    "answer": ("", "what was answered, a word of the choices"),
    "correct": ("", "1: the answer was right"),
    "response_ms": ("ms", "from the question to the answer, by the clock of the page"),
    "onset_s": ("s", "beginning of the trial since the session was started or resumed"),
    "played": ("", "what the engine wrote for the stimulus that is asked about: click or drive"),
    "frequency_hz": ("Hz", "frequency of a drive"),
    "felt_low_db": ("dB", "predicted level at the finger that feels: 5 % of the sampled bars and fingers are below"),
    "felt_db": ("dB", "predicted level there with the bar and the finger as described"),
    "quiet_db": ("dB", "predicted level at the other finger with the bar and the finger as described"),
    "quiet_high_db": ("dB", "predicted level there: 5 % of the sampled bars and fingers are above"),
    "gap_ms": ("ms", "from the masking click to the one that is asked about, as written"),
}
_PARTICIPANT = re.compile(r"[A-Za-z0-9]{1,32}")


@dataclass(frozen=True)
class SessionFiles:
    """Where a session's files are: `stem` and an ending for each."""

    folder: Path
    stem: str

    @classmethod
    def of(cls, folder: Path, protocol: Protocol, participant: str) -> "SessionFiles":
        """Raises ExperimentError for a participant whose name is no label."""
        if not _PARTICIPANT.fullmatch(participant):
            raise ExperimentError(f"--participant {participant!r}: expected 1 to 32 letters and digits, and no name")
        return cls(folder, f"sub-{participant}_task-{re.sub('[^A-Za-z0-9]', '', protocol.name)}")

    def path(self, ending: str) -> Path:
        """A file, such as that of "beh.csv"."""
        return self.folder / f"{self.stem}_{ending}"

    def begin(self, protocol: Protocol, participant: str, device: Device, consent: str, *, is_simulated: bool) -> None:
        """Write the JSON file, or compare it with the one that is there.

        Raises ExperimentError where that is of another protocol, device or kind of observer.
        """
        described = {
            "TaskName": protocol.name,
            "TaskDescription": protocol.title,
            "Participant": participant,
            "Simulated": is_simulated,
            "Device": device.name,
            "DeviceFingerprint": device.fingerprint,
            "Threshold": device.threshold.title,
            "Software": {"Name": "tactable", "Version": metadata.version("tactable")},
            "Consent": consent,
            "Protocol": to_plain(protocol),
            "Columns": {name: {"Units": unit, "Description": text} for name, (unit, text) in COLUMNS.items()},
        }
        path = self.path("beh.json")
        if path.exists():
            try:
                before = json.loads(path.read_text(encoding="utf-8"))
            except ValueError as error:
                raise ExperimentError(f"{path}: is no JSON ({error}): choose another --output") from None
            for key in ("Protocol", "DeviceFingerprint", "Simulated"):
                if before.get(key) != json.loads(json.dumps(described[key])):
                    raise ExperimentError(
                        f"{path}: {key} is another one than that of this session: choose another --output or "
                        "--participant, or give what the session was begun with"
                    )
            return
        self.folder.mkdir(parents=True, exist_ok=True)
        write_text(path, json.dumps(described, indent=2, ensure_ascii=False) + "\n")

    def resume(self, session: Session) -> tuple[list[dict[str, str]], str]:
        """Give a new session the trials of the file; its rows, and what to say of half a row that was dropped.

        Raises ExperimentError for a file that is none, or of another protocol.
        """
        path = self.path("beh.csv")
        if not path.exists():
            return [], ""
        whole, _, half = path.read_text(encoding="utf-8").rpartition("\n")
        rows = list(csv.DictReader(io.StringIO(whole)))
        for number, row in enumerate(rows, 1):
            _replay(session, row, f"{path}: trial {number}")
        if half:
            write_text(path, whole + "\n" if whole else "")
            return rows, f"{path}: the last row is not whole and was dropped; its trial is asked again"
        return rows, ""

    def append(self, row: Mapping[str, Any]) -> None:
        """Write one row, a header before the first, and flush it to the disk."""
        path = self.path("beh.csv")
        is_new = not path.exists() or not path.stat().st_size
        with path.open("a", newline="", encoding="utf-8") as file:
            rows = csv.DictWriter(file, COLUMNS, lineterminator="\n")
            if is_new:
                rows.writeheader()
            rows.writerow({name: "" if row.get(name) is None else row[name] for name in COLUMNS})
            file.flush()
            os.fsync(file.fileno())


def row_of(trial: Trial, answer: int, is_right: bool, more: Mapping[str, Any]) -> dict[str, Any]:
    """The row of a trial; `more` has the columns that only a played trial has."""
    task = trial.task
    return {
        "trial": trial.number + 1,
        "task": task.name,
        "kind": task.kind,
        "role": trial.role,
        "finger": trial.finger,
        "side": trial.side,
        "level_db": trial.level_db,
        "answer": task.choices[answer],
        "correct": int(is_right),
        **more,
    }


def _replay(session: Session, row: Mapping[str, str], where: str) -> None:
    due = session.next_trial()
    if due is None:
        raise ExperimentError(f"{where}: the protocol has only {session.total} trials: the file is of another one")
    try:
        role, finger, side = Role(row["role"]), int(row["finger"]), int(row["side"])
        level_db = float(row["level_db"]) if row["level_db"] else None
        answer = due.task.choices.index(row["answer"])
        if row["task"] != due.task.name:
            raise ValueError(f"task {row['task']!r}, and {due.task.name!r} is due")
    except (KeyError, TypeError, ValueError) as error:
        raise ExperimentError(f"{where}: is no row of this session ({error}): choose another --output") from None
    session.record(due._replace(role=role, finger=finger, side=side, level_db=level_db), answer)
