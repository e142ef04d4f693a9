"""Fault injection for everything that writes: full disk, read-only, no permission, kill -9; one command, all counts.

    python -m tests.studies.trust.faults --seed 1 --kills 200

Each command of WRITERS runs in a mount namespace of its own, where the folder that it writes to is a small tmpfs with
so many bytes left, is mounted read-only, or may not be written. A command that cannot write must end with exit status
1 and one line, and the folder must be as it was before; a fleet may
leave complete files of its own, from which it goes on. Kills are those of tests/studies/trust/kill_often.py: at random
instants of build, calibrate, swap and fleet, whose checks say that everything is whole and goes on.

It needs `unshare` and `setpriv` (util-linux) and a kernel that allows a mount namespace to this user.
"""

import argparse
import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

from engine.device import Device
from precompute.builder.table_build import build_table
from tests.precompute.fleet.small_fleet import small_text, write_measurements, write_unit
from tests.studies.trust.kill_often import kill_often, work_of

ROOT = Path(__file__).parents[3]
WRITERS = {
    "new": "new bar --length 300mm --thickness 1mm --actuators 40mm,260mm -o {out}/bar.toml",
    "build": "build {inputs}/device.toml -o {out}/table.nc --clicks-up-to 0 --workers 1 --no-reuse",
    "simulate": "simulate-measurements {inputs}/device.toml -o {out}/measured.csv",
    "calibrate": "calibrate {inputs}/device.toml {inputs}/measurements.csv -o {out}/fitted --starts 1",
    "plot": "plot reach {inputs}/device.toml -o {out}/reach.png",
    "measure": "measure {inputs}/device.toml -o {out}/bar.csv --peaks {out}/peaks.csv --port simulated "
    "--sensor simulated --places 2 --frequencies 100",
    "verify": "verify {inputs}/table.nc --port simulated --sensor simulated --placements 1 --places 2 "
    "-o {out}/verified.png -o {out}/verified.csv",
    "effects": "effects show click -o {out}/click.hjif",
    "record": "record simulated -o {out}/touches.hid --seconds 0.2",
    "fleet": "fleet {inputs}/bars -o {out}/fleet --clicks-up-to 0",
}
CONTINUED = {"fleet": "./fleet", "measure": "./bar.csv.raw"}
"""These keep what is complete, and go on from it when they run again."""
FREE_KIB = (0, 4, 64, 256)
"""Bytes left on the full disk."""
KILLED = ("build", "calibrate", "swap", "fleet")
_COMMAND = "from tactable.cli.main import main; main()"
_KEPT = "kept.txt"
# The folder is mounted, filled as the case says, and told of after the command, all in one namespace.
_SCRIPT = """
mount -t tmpfs -o size={size_kib}k none "$OUT" || exit 99
cp "$INPUTS/kept.txt" "$INPUTS/table.nc" "$OUT" && {prepare} || exit 99
{drop} "$@"
status=$?
(cd "$OUT" && find . -mindepth 1 -type f -exec sha256sum {{}} + ; find . -mindepth 1 -type d) > "$INPUTS/after.txt"
exit $status
"""
_DROP = "setpriv --bounding-set=-dac_override,-dac_read_search"


def conditions(before_kib: int) -> dict[str, dict[str, str]]:
    """What stands in the script, by the name of the fault."""
    whole = {"size_kib": str(before_kib + 16_384), "prepare": "true", "drop": ""}
    return {
        **{f"disk full, {free} KiB left": {**whole, "size_kib": str(before_kib + free)} for free in FREE_KIB},
        "read-only": {**whole, "prepare": 'mount -o remount,ro "$OUT"'},
        "no permission": {**whole, "prepare": 'chmod 500 "$OUT"', "drop": _DROP},
    }


def make_inputs(folder: Path) -> int:
    """A device, measurements, a fleet and a table that is there before; the KiB of what the folder holds before."""
    unit = write_unit(folder / "unit", small_text())
    write_measurements(unit, small_text("20.5 kN/m"))
    for name in ("device.toml", "measurements.csv"):
        shutil.move(unit / name, folder / name)
    write_unit(folder / "bars" / "good", small_text())
    (folder / _KEPT).write_text("as before\n", encoding="utf-8")
    build_table(Device.read(folder / "device.toml"), folder / "table.nc", clicks_up_to=0)
    pages = sum(-(-(folder / name).stat().st_size // 4096) for name in (_KEPT, "table.nc"))
    return 4 * pages


def inject(name: str, condition: dict[str, str], folder: Path) -> tuple[str, str]:
    """Run a writer under a fault: `refused` or `fitted`, and what is wrong with how it ended, "" for nothing."""
    out = folder / "out"
    out.mkdir(exist_ok=True)
    words = WRITERS[name].format(inputs=folder, out=out).split()
    script = _SCRIPT.format(**condition)
    unshare = ["unshare", "-m"] if os.geteuid() == 0 else ["unshare", "-rm"]
    command = [*unshare, "sh", "-c", script, "sh", sys.executable, "-c", _COMMAND, *words]
    environment = os.environ | {"OUT": str(out), "INPUTS": str(folder), "PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    if done.returncode == 99:
        raise OSError(f"the case cannot be prepared here: {done.stderr.strip()}")
    if done.returncode in (0, 3):
        return "fitted", ""
    before = {f"{hashlib.sha256((folder / each).read_bytes()).hexdigest()}  ./{each}" for each in (_KEPT, "table.nc")}
    left = set((folder / "after.txt").read_text(encoding="utf-8").splitlines()) ^ before
    if name in CONTINUED:
        left = {line for line in left if "partial" in line or CONTINUED[name] not in line}
    said = [line.startswith("tactable: ") for line in done.stderr.splitlines() if line]
    if done.returncode != 1:
        return "refused", f"exit status {done.returncode}: {done.stderr[-300:]}"
    if said.count(True) != 1 or not said[-1] or "Traceback" in done.stderr:
        return "refused", f"no single line of error: {done.stderr[-300:]}"
    return "refused", f"left or changed: {sorted(left)}" if left else ""


def inject_all(writers: list[str]) -> tuple[dict[str, Counter[str]], list[str]]:
    """Every writer under every fault: outcomes by fault, and what went wrong."""
    outcomes, faults = dict[str, Counter[str]](), list[str]()
    with tempfile.TemporaryDirectory() as folder:
        cases = conditions(make_inputs(Path(folder)))
        for fault, condition in cases.items():
            outcomes[fault] = Counter()
            for name in writers:
                outcome, wrong = inject(name, condition, Path(folder))
                outcomes[fault][outcome] += 1
                if wrong:
                    faults.append(f"{name}, {fault}: {wrong}")
    return outcomes, faults


def kill_all(kills: int, seed: int) -> tuple[dict[str, Counter[str]], list[str]]:
    """`kills` of each work: how far it was, and the checks that failed."""
    outcomes, faults = dict[str, Counter[str]](), list[str]()
    for name in KILLED:
        with tempfile.TemporaryDirectory() as folder, work_of(name, Path(folder)) as work:
            try:
                reached, ended = kill_often(work, Path(folder), kills, seed)
                outcomes[f"kill -9, {name}"] = Counter({**reached, "ended": ended})
            except Exception as error:  # whatever a check raised is a fault
                faults.append(f"kill -9, {name}: {type(error).__name__}: {error}")
    return outcomes, faults


def main() -> None:
    """Inject all faults and print the counts; exit status 1 for a fault that did damage."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kills", type=int, default=200, help="of each of build, calibrate, swap and fleet")
    parser.add_argument("--writer", action="append", choices=WRITERS)
    options = parser.parse_args()
    outcomes, faults = inject_all(options.writer or list(WRITERS))
    if options.kills:
        killed, damage = kill_all(options.kills, options.seed)
        outcomes, faults = {**outcomes, **killed}, [*faults, *damage]
    for fault, counts in outcomes.items():
        print(f"{fault}: " + ", ".join(f"{count} {word}" for word, count in sorted(counts.items())))
    print(*(f"FAULT {fault}" for fault in faults), sep="\n")
    raise SystemExit(1 if faults else 0)


if __name__ == "__main__":
    main()
