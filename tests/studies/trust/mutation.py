"""Mutation testing of what safety rests on: whether a test fails when one line of it is wrong.

    python -m tests.studies.trust.mutation --seed 1 --count 400 --results mutation.jsonl

Mutants (mutants.py) of the modules below are drawn by the seed. Each is put into a copy of the tree, and only the tests
that mirror its module run, until the first fails. It is *killed* if one does, or if it hangs; otherwise it *survived*.
A C mutant whose object code is that of the original is *the same* and does not count, nor does one that does not
compile. Survivors that a person has found equivalent are in equivalent_mutants.toml, each with its reason.

With `--results` a run that was stopped goes on where it was, and survivors run again, since tests may have been added.
mutmut and cosmic-ray, which are well kept, know only Python: half of what is tested here is C, and one list of
operators, one sample and one report for both was less than an adapter for either.
"""

import argparse
import hashlib
import json
import multiprocessing
import os
import queue
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
from collections import Counter
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path

from engine.loop.fast.fast_layout import c_header
from tests.studies.trust.mutants import Mutant, mutants_of

ROOT = Path(__file__).parents[3]
EQUIVALENT = Path(__file__).with_name("equivalent_mutants.toml")
FIRMWARE, STEP = "firmware_link/firmware", "engine/loop/fast/step.c"
WORKERS = 2
MOST_MEMORY = 6 << 30
_PYTEST = (
    *("-n", "0", "-x", "-q", "-p", "no:cacheprovider", "--hypothesis-seed=1"),
    *("-k", "not undefined", "-m", "not machine"),
    *("-W", "ignore::pytest.PytestAssertRewriteWarning"),  # hypothesis is imported before
)
TOLD = "told.log"  # in a tree: what the last tests printed
_OURS = ("tests", "tactable", "precompute", "engine", "firmware_link", "base")
_FORKS = multiprocessing.get_context("forkserver")
_PRELOADED = ["pytest", "xdist", "hypothesis", "numpy", "numpy.random", "numpy.testing", "h5py", "h5netcdf", "anyio"]

_EMULATOR = tuple(
    f"tests/firmware_link/{name}.py"
    for name in ("test_conformance", "emulator/test_firmware", "emulator/test_synthesis", "firmware/test_twins")
)
_CORE = tuple(f"tests/{FIRMWARE}/test_{name}.py" for name in ("core", "framing", "twins", "synthesis"))
_HOST = tuple(f"tests/firmware_link/{name}.py" for name in ("host/test_session", "host/test_outbox", "host/test_link"))
_LOOP_CONTROL = "tests/engine/loop/test_program_steps.py"


def _control(*names: str) -> tuple[str, ...]:
    return tuple(f"tests/tactable/control/test_{name}.py" for name in names)


TESTS: dict[str, tuple[str, ...]] = {
    "engine/render/limits.py": ("tests/engine/render/test_limits.py",),
    "engine/effects/effect_player.py": (
        *("tests/engine/effects/test_effect_player.py", "tests/engine/effects/test_control_step.py"),
        *(_LOOP_CONTROL, "tests/engine/loop/test_bar_change.py"),
    ),
    "engine/effects/effect_play.py": (
        "tests/engine/effects/test_effect_player.py",
        "tests/engine/effects/test_control_step.py",
    ),
    "engine/loop/beside.py": (
        *(_LOOP_CONTROL, "tests/engine/loop/test_table_swap.py", "tests/engine/loop/test_awaited_clicks.py"),
    ),
    "tactable/control/requests.py": _control("steps", "control_server", "laws"),
    "tactable/control/control_server.py": _control("control_server", "laws"),
    "tactable/control/steps.py": _control("steps", "laws"),
    "tactable/control/security.py": _control("security"),
    "tactable/control/slot.py": _control("in_process"),
    "tactable/control/control_process.py": _control("in_process", "unix_socket"),
    "tactable/control/osc.py": _control("osc", "in_process"),
    "engine/touch/finger_tracker.py": tuple(
        f"tests/engine/{each}.py"
        for each in ("touch/test_finger_tracker", "touch/test_placement", "loop/test_bar_change")
    ),
    "engine/touch/placement.py": ("tests/engine/touch/test_placement.py",),
    STEP: ("tests/engine/loop/fast/test_fast_path.py", "tests/engine/loop/fast/test_step.py"),
    "firmware_link/host/outbox.py": _HOST,
    "firmware_link/host/session.py": _HOST,
    "firmware_link/protocol/framing.py": (
        *("tests/firmware_link/protocol/test_framing.py", f"tests/{FIRMWARE}/test_framing.py"),
        *_HOST,
    ),
    "firmware_link/protocol/basis.py": ("tests/firmware_link/protocol/test_basis.py", *_EMULATOR),
    **{
        f"firmware_link/emulator/{name}.py": _EMULATOR
        for name in ("device_lease", "device_session", "sounding", "tones", "synthesis", "device_memory", "sense")
    },
    **{
        f"{FIRMWARE}/core/{name}.c": _CORE
        for name in (
            *("lease", "session", "drive", "synthesis", "tones", "voice", "click", "channels", "framing", "cobs"),
            *("basis", "memory", "sense", "stream"),
        )
    },
}
"""The modules, and the tests that mirror them."""


@dataclass
class Tree:
    """A copy of the checked-out tree, in which one mutant at a time runs."""

    folder: Path
    limit_s: float = 600.0

    @classmethod
    def copied(cls, folder: Path) -> "Tree":
        """The files that git knows, as they are now."""
        listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True).stdout
        for name in filter(None, listed.decode().split("\0")):
            if (ROOT / name).is_file():
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy(ROOT / name, folder / name)
        return cls(folder)

    def outcome(self, mutant: Mutant) -> str:
        """What the tests say: killed, hangs, survived; or invalid, same."""
        path = self.folder / mutant.path
        original = path.read_text(encoding="utf-8")
        mutated = mutant.apply(original)
        try:
            if path.suffix == ".py":
                compile(mutated, mutant.path, "exec")
            else:
                before = self.object_code(mutant.path)
            path.write_text(mutated, encoding="utf-8")
            if path.suffix == ".c":
                after = self.object_code(mutant.path)
                if after is None or after == before:
                    return "invalid" if after is None else "same"
            return self.run_tests(mutant.path)
        except SyntaxError:
            return "invalid"
        finally:
            path.write_text(original, encoding="utf-8")

    def object_code(self, path: str) -> bytes | None:
        """What the compiler makes of a C file, for the compiled step a library; None where it refuses."""
        made = self.folder / "mutant.so"
        flags = ["-O2", path, "-o", str(made), f"-I{self.folder}", f"-I{FIRMWARE}/core", "-fPIC"]
        if path == STEP:
            (self.folder / "layout.h").write_text(c_header(), encoding="ascii")
            # What nothing was written to has a value that shows.
            flags += ["-std=c11", "-ffp-contract=off", "-ftrivial-auto-var-init=pattern", "-shared", "-lm"]
        else:
            flags += ["-std=c99", "-DTACTABLE_ACTUATORS=255u", "-Wall", "-Wextra", "-Werror", "-c"]
        done = subprocess.run(["cc", *flags], cwd=self.folder, capture_output=True, check=False)
        return made.read_bytes() if done.returncode == 0 else None

    def run_tests(self, path: str) -> str:
        """Killed, hangs or survived."""
        variables = {"PYTHONPATH": str(self.folder)}
        if path == STEP:
            self.object_code(path)
            variables["TACTABLE_STEP_LIBRARY"] = str(self.folder / "mutant.so")
        elif path.endswith(".c"):
            build = self.folder / "core_build"
            shutil.rmtree(build, ignore_errors=True)
            extra = " ".join(f"../../tests/{FIRMWARE}/c/{name}.c" for name in ("decoder", "held_samples"))
            make = ["make", "-C", FIRMWARE, f"BUILD={build}", f"EXTRA={extra}", "host"]
            if subprocess.run(make, cwd=self.folder, capture_output=True, check=False).returncode:
                return "invalid"
            variables["TACTABLE_CORE_LIBRARY"] = str(build / "libtactable_core.so")
        child = _FORKS.Process(target=_test, args=(self.folder, TESTS[path], variables))
        child.start()
        child.join(self.limit_s)
        if child.exitcode is None:
            assert child.pid is not None
            os.killpg(child.pid, signal.SIGKILL)
            child.join()
            return "hangs"
        return "survived" if child.exitcode == 0 else "killed"


def _test(folder: Path, tests: tuple[str, ...], variables: dict[str, str]) -> None:
    """Run tests of a tree in this process, which has imported what is not ours already; ends it."""
    import pytest

    os.setsid()
    resource.setrlimit(resource.RLIMIT_AS, (MOST_MEMORY, MOST_MEMORY))
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    told = os.open(folder / TOLD, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    for descriptor in (1, 2):
        os.dup2(told, descriptor)
    for name in [name for name in sys.modules if name.split(".")[0] in _OURS]:
        del sys.modules[name]
    os.chdir(folder)
    sys.path.insert(0, str(folder))
    sys.dont_write_bytecode = True
    os.environ.update(variables)
    os._exit(pytest.main([*_PYTEST, *tests]))


def drawn(modules: list[str], seed: int, count: int) -> list[Mutant]:
    """Mutants of the modules in an order that the seed shuffles; a change of one line moves none of the others."""
    mutants = [mutant for path in modules for mutant in mutants_of(path, (ROOT / path).read_text(encoding="utf-8"))]
    return sorted(mutants, key=lambda mutant: hashlib.sha256(f"{seed} {mutant.name}".encode()).digest())[:count]


def equivalents() -> dict[str, str]:
    """The reason of every mutant that a person has found to behave as the original, by its name."""
    groups = tomllib.loads(EQUIVALENT.read_text(encoding="utf-8"))["group"]
    return {name: group["reason"] for group in groups for name in group["mutants"]}


def run(mutants: list[Mutant], results: Path | None, workers: int = WORKERS) -> dict[str, str]:
    """The outcome of each mutant by its name. What `results` holds already is not run again, but for survivors."""
    known, outcomes = equivalents(), dict[str, str]()
    if results is not None and results.exists():
        for line in results.read_text(encoding="utf-8").splitlines():
            record = json.loads(line)
            outcomes[record["mutant"]] = record["outcome"]
    outcomes = {name: outcome for name, outcome in outcomes.items() if outcome != "survived"}
    outcomes |= {mutant.name: "equivalent" for mutant in mutants if mutant.name in known}
    todo = [mutant for mutant in mutants if mutant.name not in outcomes]
    _FORKS.set_forkserver_preload(_PRELOADED)  # half of a test's time would be imports
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(workers) as pool:
        trees = queue.Queue[Tree]()
        for number in range(workers):
            (Path(folder) / str(number)).mkdir()
            trees.put(Tree.copied(Path(folder) / str(number)))
        suites = sorted({(TESTS[path], path.endswith(".c")) for path in _paths(todo)})
        baselines_s = dict(zip(suites, pool.map(lambda suite: _baseline_s(suite, trees), suites), strict=True))

        def judge(mutant: Mutant) -> tuple[Mutant, str]:
            tree = trees.get()
            try:
                tree.limit_s = baselines_s[TESTS[mutant.path], mutant.path.endswith(".c")]
                return mutant, tree.outcome(mutant)
            finally:
                trees.put(tree)

        for number, future in enumerate(as_completed([pool.submit(judge, mutant) for mutant in todo]), 1):
            mutant, outcome = future.result()
            outcomes[mutant.name] = outcome
            print(f"{number}/{len(todo)} {outcome}: {mutant.line}: {mutant.name}", file=sys.stderr, flush=True)
            if results is not None:
                with results.open("a", encoding="utf-8") as file:
                    file.write(json.dumps({"mutant": mutant.name, "line": mutant.line, "outcome": outcome}) + "\n")
    return {mutant.name: outcomes[mutant.name] for mutant in mutants}


def _paths(mutants: list[Mutant]) -> list[str]:
    return sorted({mutant.path for mutant in mutants})


def _baseline_s(suite: tuple[tuple[str, ...], bool], trees: "queue.Queue[Tree]") -> float:
    """The time after which tests hang: five times what they take without a mutant, and 30 s."""
    path = next(path for path, tests in TESTS.items() if (tests, path.endswith(".c")) == suite)
    tree, begin_s = trees.get(), time.monotonic()
    outcome = tree.run_tests(path)
    told = (tree.folder / TOLD).read_text(encoding="utf-8", errors="replace")
    trees.put(tree)
    assert outcome == "survived", f"{path}: its tests fail without a mutant ({outcome}):\n{told[-4000:]}"
    return 30 + 5 * (time.monotonic() - begin_s)


def summary(mutants: list[Mutant], outcomes: dict[str, str]) -> dict[str, object]:
    """Counts by module and altogether, and the names of the survivors."""
    modules = {path: Counter(outcomes[m.name] for m in mutants if m.path == path) for path in _paths(mutants)}
    total = sum(modules.values(), Counter[str]())
    dead, survived = total["killed"] + total["hangs"], total["survived"]
    return {
        "mutants": total.total(),
        **{kind: total[kind] for kind in ("killed", "hangs", "survived", "equivalent", "same", "invalid")},
        "killed_of_those_not_equivalent": dead / max(1, dead + survived),
        "modules": {path: dict(counts) for path, counts in modules.items()},
        "survivors": sorted(name for name, outcome in outcomes.items() if outcome == "survived"),
    }


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=400, help="how many mutants are drawn")
    parser.add_argument("--module", action="append", help="a part of a path; may be repeated")
    parser.add_argument("--results", type=Path, help="a JSON-lines file that a stopped run goes on from")
    options = parser.parse_args()
    modules = [path for path in TESTS if not options.module or any(part in path for part in options.module)]
    if not modules:
        parser.error(f"no such module; there are {', '.join(TESTS)}")
    mutants = drawn(modules, options.seed, options.count)
    report = summary(mutants, run(mutants, options.results))
    for key, value in report.items():
        if not isinstance(value, dict | list):
            print(f"{key.replace('_', ' ')}: {value:.1%}" if isinstance(value, float) else f"{key}: {value}")
    print(*(f"survived: {name}" for name in report["survivors"]), sep="\n")  # type: ignore[attr-defined]  # a list


if __name__ == "__main__":
    main()
