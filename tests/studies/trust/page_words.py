"""Whether the page's sentence and its labels say the same after every one of many random inputs, in Chromium.

`python -m tests.studies.trust.page_words [DEVICE] [--draws N]`: fingers come down, move and lift, switches and the bar
change. After each, soon and once it has settled, the sentence is read with the labels of both bars, as one frame drew
them.
"""

import re
import tempfile
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from playwright.sync_api import sync_playwright

from tests.studies.options import read_options
from tests.system.page import CHROMIUM, Demo, Visit, opened

_SHOWN = """(() => {
const labels = (view) => Object.fromEntries(view._slots.filter((s) => s.said).map((s) => [s.number + 1, s.said]));
const box = document.getElementById("outcome");
return { sentence: box.hasAttribute("data-old") ? "" : box.textContent, ours: labels(tactable.bar),
  paper: tactable.wire.picture.hasPaper ? labels(tactable.second) : {},
  roles: Object.fromEntries(tactable.wire.picture.made.slice(0, tactable.wire.picture.madeCount)
    .map((f) => [f.called + 1, f.role])) }; })()"""
_FELT, _QUIET = 2, 1
_LOWEST_DB = -20.0
_ROUNDED_DB = 0.61  # a whole number of dB, of two levels of a tenth
_CLAIM = re.compile(r"feels? the (?:click|vibration)|not feel the (?:click|vibration)")


@dataclass(frozen=True)
class Levels:
    """What the labels of one bar say of the fingers of a command: levels in dB, and whether each is called felt."""

    felt: list[tuple[float, bool]]
    quiet: list[tuple[float, bool]]

    @property
    def apart_db(self) -> float:
        """How much more the felt fingers get than the quiet ones."""
        return min(db for db, _ in self.felt) - max(max(db for db, _ in self.quiet), _LOWEST_DB)


def levels_of(labels: dict[str, str], roles: dict[str, int]) -> Levels | None:
    """The levels of a command's fingers; None where one of them has no label, or its label says to wait."""
    found: dict[int, list[tuple[float, bool]]] = {_FELT: [], _QUIET: []}
    for finger, role in roles.items():
        text, _, word = labels.get(finger, "").rpartition(", ")
        if word not in ("felt", "not felt"):
            return None
        number = re.search(r"-?[\d.]+", text.replace("\N{MINUS SIGN}", "-"))
        db = _LOWEST_DB - 1 if text == "nothing" or text.startswith("below") or number is None else float(number[0])
        found[role].append((db, word == "felt"))
    return Levels(found[_FELT], found[_QUIET]) if found[_FELT] else None


def disagreement(shown: dict[str, Any]) -> str | None:
    """In what the sentence and the labels differ; None where they agree, "" where there is nothing to compare."""
    ours, others = shown["sentence"].replace("\N{MINUS SIGN}", "-").partition("; the paper")[::2]
    if not _CLAIM.search(ours):
        return ""
    found = [_differ(ours, levels_of(shown["ours"], shown["roles"]))]
    if others:
        found.append(_differ_of_paper(others, levels_of(shown["paper"], shown["roles"])))
    return next((each for each in found if each), "" if "" in found else None)


def _differ(ours: str, levels: Levels | None) -> str | None:
    if levels is None:
        return ""
    if any((db >= 0) != is_felt for db, is_felt in (*levels.felt, *levels.quiet) if db):  # -0.04 is "-0.0, not felt"
        return "a label's number and its word"
    says_felt = "not feel the" not in ours
    if says_felt != all(is_felt for _, is_felt in levels.felt):
        return "whether it is felt"
    if not says_felt:
        return None
    if not levels.quiet:
        return _apart(ours, r"([-\d.]+) dB above", min(db for db, _ in levels.felt), 0.051)
    if "no more than" in ours:
        return None if levels.apart_db < 1 else "no more"
    if ("nothing" in ours) == any(is_felt for _, is_felt in levels.quiet):
        return "whether the others feel nothing"
    return _apart(ours, r"(-?\d+) dB more", levels.apart_db, _ROUNDED_DB)


def _differ_of_paper(others: str, levels: Levels | None) -> str | None:
    if levels is None:
        return ""
    if "not felt" in others:
        return "the paper's drive is felt" if all(is_felt for _, is_felt in levels.felt) else None
    if not levels.quiet:
        return _apart(others, r"(-?[\d.]+) dB", min(db for db, _ in levels.felt), 0.051)
    return _apart(others, r"(-?\d+) dB", levels.apart_db, _ROUNDED_DB)


def _apart(text: str, pattern: str, expected_db: float, tolerance_db: float) -> str | None:
    said = re.search(pattern, text)
    if said is None or abs(float(said[1]) - expected_db) > tolerance_db:
        return f"{said and said[1]} for {expected_db:.1f} dB"
    return None


def act(visit: Visit, random: np.random.Generator) -> None:
    """One random input."""
    fingers, what = sorted(visit.down), random.random()
    if what < 0.15:
        switch = [
            {"source": str(random.choice(["click", "steady", "zones"]))},
            {"level_db": [10, 20, 30, None][random.integers(4)]},
            {"is_loaded": bool(random.integers(2))},
            {"is_other": bool(random.integers(2))},
        ][random.integers(4)]
        visit.page.evaluate("(switches) => tactable.wire.choose(switches)", switch)
    elif fingers and (what < 0.5 or len(fingers) == 4):
        finger = f"f{random.choice(fingers)}"
        visit.touch(**{finger: None if what < 0.4 else float(random.uniform(0.02, 0.98))})
    else:
        number = next(number for number in range(1, 9) if number not in fingers)
        visit.touch(**{f"f{number}": float(random.uniform(0.02, 0.98))})


def main() -> None:
    """Print every disagreement, and how many inputs were compared."""
    options = read_options(__doc__, device=("reference-t",), draws=500)
    random, compared, differing, kinds = np.random.default_rng(1), 0, 0, Counter[str]()
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        demo, browser = Demo(Path(folder), device=options.device), playwright.chromium.launch(executable_path=CHROMIUM)
        try:
            with opened(demo, browser) as visit:
                for step in range(options.draws):
                    act(visit, random)
                    # Soon after the input, when a click may still play, and once more when all has settled.
                    for least_ms, most_ms in ((20, 600), (600, 900)):
                        visit.page.wait_for_timeout(float(random.uniform(least_ms, most_ms)))
                        shown = visit.ask(_SHOWN)
                        found = disagreement(shown)
                        compared += found != ""
                        kinds[shown["sentence"][:24] if found == "" else "compared"] += 1
                        if found:
                            differing += 1
                            print(f"{step}: {found}: {shown}", flush=True)
        finally:
            browser.close()
            demo.stop()
    print(f"{differing} of {compared} compared differ, after {options.draws} inputs; {dict(kinds)}")


if __name__ == "__main__":
    main()
