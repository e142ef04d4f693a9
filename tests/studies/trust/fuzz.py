"""Fuzzers of what others write: table files, device, rule and measurement files, and messages of browsers.

    python -m tests.studies.trust.fuzz table --seed 1 --seconds 180

WHAT is one of table, device, rules, measurements, uff, page. Each case is a whole input with one to six edits.
It must be taken or refused by its own family of errors, within PATIENCE_S of processor time. Anything else is a fault,
told with seed and number, and `--first NUMBER --count 1` repeats it. Cases run in child processes, so a crash is a
fault, too.
"""

import argparse
import math
import multiprocessing
import random
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from multiprocessing.queues import SimpleQueue
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyuff

from base.plain import to_plain
from engine.device import Device, DeviceError
from engine.effects.rule_file import parse_effects
from engine.effects.rules import EffectError
from engine.table import Table, TableError
from engine.touch.sources.pointer import Phase, PointerEvent
from precompute.measurements.measurement_file import read_measurements
from precompute.measurements.types import CalibrationError
from tactable.page.choices import Choice, ChoiceError, changed, effects_of, offered
from tactable.page.page_messages import PageMessageError, decode_message
from tests.engine.made_table import click_of, in_zones, reseal, rows_of, write_table
from tests.precompute.measurements.test_uff import nodes, response
from tests.tactable.page.browser import encode_choice, encode_listen, encode_touches

PATIENCE_S = 10
BATCH = 50
TABLES = Path(__file__).parents[3] / "tables"
DEVICE = Device.read(TABLES / "devices" / "reference-a.toml")
_FORK = multiprocessing.get_context("fork")
# Values that break arithmetic and parsers.
TELLING = (
    *("0", "-1", "1e300", "-1e-300", "nan", "inf", "1e9999", "9" * 400, '"1e300 m"', '"0 mm"', '"-5 ms"'),
    *(
        '""',
        '"5 furlong"',
        "true",
        "[]",
        "{}",
        "[[1, 2]]",
        '"\\u001b[2J"',
        '"\u202e"',
        "1979-05-27",
        '"1 g_0"',
        ",",
        ";",
    ),
)
_NUMBERS = ("0", "-1", "99999", "58", "164", "1e300", "nan", "-inf", "9" * 40, "x")
_BYTES = (0, 1, 0x7F, 0x80, 0xFF, 0x0A, 0x22, 0x2C, 0x5B, 0x5D)


class Fuzzed(NamedTuple):
    """A reader: what it makes of a case in a folder, and the errors that it may raise."""

    play: Callable[[random.Random, Path], None]
    family: tuple[type[Exception], ...]


def edited_text(rng: random.Random, text: str, numbers: Sequence[str] = ()) -> str:
    """One to six edits of lines and of values in them; with `numbers`, of words in columns too."""
    lines = text.splitlines(keepends=True)
    for _ in range(rng.randint(1, 6)):
        at = rng.randrange(len(lines)) if lines else 0
        edit = rng.randrange(7)
        if edit == 0 and lines:
            del lines[at]
        elif edit == 1 and lines:
            lines.insert(rng.randrange(len(lines) + 1), lines[at])
        elif edit == 2 and lines:
            key, is_assigned, _ = lines[at].partition("=")
            lines[at] = f"{key}= {rng.choice(TELLING)}\n" if is_assigned else rng.choice(TELLING) + "\n"
        elif edit == 3 and lines and numbers and lines[at].split():
            word = rng.choice(lines[at].split())
            lines[at] = lines[at].replace(word, rng.choice(numbers).rjust(len(word)), 1)
        elif edit == 3 and lines:
            cells = lines[at].split(",")
            cells[rng.randrange(len(cells))] = rng.choice(TELLING)
            lines[at] = ",".join(cells)
        elif edit == 4 and lines:
            place = rng.randrange(len(lines[at]) + 1)
            lines[at] = lines[at][:place] + chr(rng.choice((*_BYTES, 0x202E, 0xFEFF))) + lines[at][place + 1 :]
        elif edit == 5 and lines:
            digits = [place for place, letter in enumerate(lines[at]) if letter.isdigit()]
            for place in digits[:1]:
                lines[at] = lines[at][:place] + str(rng.randrange(10**6)) + lines[at][place + 1 :]
        elif rng.random() < 0.1:
            del lines[at:]
    return "".join(lines)


def edited_bytes(rng: random.Random, data: bytes, start: int = 0) -> bytes:
    """One to six edits of bits, bytes and length, behind `start`."""
    content = bytearray(data)
    for _ in range(rng.randint(1, 6)):
        at = rng.randrange(start, max(start + 1, len(content)))
        edit = rng.randrange(5)
        if edit < 2 and at < len(content):
            content[at] ^= 1 << rng.randrange(8)
        elif edit == 2 and at < len(content):
            content[at] = rng.choice(_BYTES)
        elif edit == 3:
            content[at : at + rng.randint(0, 4)] = rng.randbytes(rng.randint(0, 4))
        elif rng.random() < 0.1:
            del content[at:]
    return bytes(content)


def _play_table(rng: random.Random, folder: Path) -> None:
    """Sealed again after the edits, as somebody would who wants it to be taken; then all of it is read."""
    whole = folder / "whole.nc"
    if not whole.exists():
        clicks = [click_of(DEVICE, in_zones(DEVICE, [0])), click_of(DEVICE, in_zones(DEVICE, [1], [3]))]
        write_table(whole, DEVICE, clicks, rows=rows_of(DEVICE, (20.0, math.inf)))
    path, content = folder / "case.nc", bytearray(whole.read_bytes())
    for _ in range(rng.choice((1, 1, 2, 4))):
        at = rng.randrange(len(content) - 64)
        content[at] = content[at] ^ 1 << rng.randrange(8) if rng.random() < 0.7 else rng.choice(_BYTES)
    path.write_bytes(content)
    with Table.open(reseal(path)) as table:
        assert table.device.fingerprint and all(
            math.isfinite(sum(row.amplitudes)) for rows in table.best_rows.values() for row in rows
        )
        for placement in (in_zones(table.device, [0]), in_zones(table.device, [1], [3])):
            table.click_at(placement, 20.0)
        assert table.modes is None or np.isfinite(table.modes.drive).all()


def _play_device(rng: random.Random, _folder: Path) -> None:
    text = edited_text(rng, DEVICE.text)
    device = Device.parse(text, "case.toml")
    assert device.fingerprint == Device.parse(text, "case.toml").fingerprint
    for value in (device.bar.length_m, device.limits.amplitude, device.limits.slew_per_s, device.limits.lease_s):
        assert math.isfinite(value) and value > 0


def _play_rules(rng: random.Random, _folder: Path) -> None:
    names = sorted((TABLES / "effects").glob("*.toml"))
    effects = parse_effects(edited_text(rng, rng.choice(names).read_text(encoding="utf-8")), "case.toml", DEVICE)
    for rule in effects.rules:
        assert all(segment.duration_ns is None or segment.duration_ns >= 0 for segment in rule.effect.envelope)


def _play_measurements(rng: random.Random, folder: Path) -> None:
    text = (TABLES / "measurements" / "reference-a-drifted.csv").read_text(encoding="utf-8")
    path = folder / "case.csv"
    path.write_bytes(edited_text(rng, text).encode("utf-8", "surrogatepass"))
    _read_edited(path)


def _read_edited(path: Path) -> None:
    """The measurements in a file, which are finite, whatever they are."""
    read = read_measurements(path, DEVICE)
    assert np.isfinite(read.position_m).all() and np.isfinite(read.sensor_mass_kg).all()
    assert np.isfinite(read.acceleration).all() and np.isfinite(read.amplitude).all()
    assert not np.isinf(read.frequency_hz).any()


def _play_universal(rng: random.Random, folder: Path) -> None:
    """Edits of lines and bytes, in a file of text or of binary responses."""
    is_binary = rng.randrange(2)
    whole = folder / f"whole-{is_binary}.uff"
    if not whole.exists():
        sets = [nodes(), response(1, 8, binary=is_binary), response(2, 9, binary=is_binary)]
        pyuff.UFF(str(whole)).write_sets(sets, "add")
    content = whole.read_bytes()
    if rng.random() < 0.5:
        content = edited_bytes(rng, content)
    else:
        content = edited_text(rng, content.decode("latin-1"), numbers=_NUMBERS).encode("latin-1", "replace")
    path = folder / "case.uff"
    path.write_bytes(content)
    _read_edited(path)


def _play_page(rng: random.Random, _folder: Path) -> None:
    """Messages as the server takes them: decoded, and switches applied."""
    touches = [PointerEvent(rng.randrange(5), rng.random(), rng.random(), rng.choice(list(Phase))) for _ in range(3)]
    choice = to_plain(Choice(DEVICE.name))
    key, offers = rng.choice(list(choice)), offered(DEVICE.name)
    odd: object = rng.choice(
        (None, -1, 1e308, "", [], {}, [[]], True, "touch", choice[key], ["I", "I"], [3], "\x1b[2J", 10**400)
    )
    whole = rng.choice((encode_touches(touches), encode_choice({**choice, key: odd}), encode_listen(rng.randrange(9))))
    asked = decode_message(whole if rng.random() < 0.3 else edited_bytes(rng, whole, rng.choice((0, 2))))
    if isinstance(asked, dict):
        effects_of(changed(Choice(DEVICE.name), asked, DEVICE, offers), DEVICE, None)
    elif isinstance(asked, tuple):
        assert all(math.isfinite(event.x) and math.isfinite(event.y) for event in asked)


FUZZED = {
    "table": Fuzzed(_play_table, (TableError,)),
    "device": Fuzzed(_play_device, (DeviceError,)),
    "rules": Fuzzed(_play_rules, (EffectError,)),
    "measurements": Fuzzed(_play_measurements, (CalibrationError,)),
    "uff": Fuzzed(_play_universal, (CalibrationError,)),
    "page": Fuzzed(_play_page, (PageMessageError, ChoiceError)),
}


@contextmanager
def _patience() -> Iterator[None]:
    """Raises TimeoutError in what computes for longer than PATIENCE_S."""

    def end(_number: int, _frame: object) -> None:
        raise TimeoutError(f"more than {PATIENCE_S} s of processor time")

    signal.signal(signal.SIGPROF, end)
    signal.setitimer(signal.ITIMER_PROF, PATIENCE_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)


def outcome_of(fuzzed: Fuzzed, seed: int, number: int, folder: Path) -> str:
    """Taken, refused, or the fault."""
    try:
        fuzzed.play(random.Random(f"{seed} {number}"), folder)
    except fuzzed.family as refusal:
        return "refused" if str(refusal) else "fault: a refusal without words"
    except Exception as error:  # that is what is looked for
        where = traceback.extract_tb(error.__traceback__)[-1]
        return f"fault: {type(error).__name__}: {str(error)[:200]} ({Path(where.filename).name}:{where.lineno})"
    return "taken"


def _play_batch(
    fuzzed: Fuzzed, seed: int, numbers: range, folder: Path, outcomes: "multiprocessing.SimpleQueue[str]"
) -> None:
    for number in numbers:
        with _patience():
            outcome = outcome_of(fuzzed, seed, number, folder)
        outcomes.put(outcome)


def fuzz(
    what: str, seed: int, first: int, count: int, seconds: float = math.inf
) -> tuple[Counter[str], dict[int, str]]:
    """Play cases `first` to `first + count`, no longer than `seconds`: outcomes, and faults by their numbers."""
    outcomes, faults, number, end_s = Counter[str](), dict[int, str](), first, time.monotonic() + seconds
    with tempfile.TemporaryDirectory() as folder:
        while number < first + count and time.monotonic() < end_s:
            numbers = range(number, min(number + BATCH, first + count))
            said: SimpleQueue[str] = _FORK.SimpleQueue()
            child = _FORK.Process(target=_play_batch, args=(FUZZED[what], seed, numbers, Path(folder), said))
            child.start()
            child.join()
            while not said.empty():
                outcome = said.get()
                kind, _, fault = outcome.partition(": ")
                outcomes[kind] += 1
                if fault:
                    faults[number] = fault
                number += 1
            if number < numbers.stop:  # it ended in the middle of a case
                outcomes["fault"] += 1
                faults[number] = f"the process ended with exit status {child.exitcode}"
                number += 1
    return outcomes, faults


def main() -> None:
    """Play and print; exit status 1 for a fault."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("what", choices=FUZZED)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--count", type=int, default=sys.maxsize)
    parser.add_argument("--seconds", type=float, default=60.0)
    options = parser.parse_args()
    outcomes, faults = fuzz(options.what, options.seed, options.first, options.count, options.seconds)
    report = {"what": options.what, "seed": options.seed, "cases": outcomes.total(), **outcomes}
    print(", ".join(f"{key} {value}" for key, value in report.items()))
    for number, fault in faults.items():
        print(f"case {number}: {fault}")
    raise SystemExit(1 if faults else 0)


if __name__ == "__main__":
    main()
