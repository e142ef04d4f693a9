"""What a command cannot do it refuses in one line, which names the thing and the remedy, and it leaves no file."""

import shlex
import shutil
from pathlib import Path

import pytest

from tactable.shipped import device_folder
from tests.precompute.builder.test_table_build import ONE_LEVEL, SMALL
from tests.precompute.fleet.small_fleet import small_text, write_unit
from tests.tactable.cli.in_process import run_here

NEW = "new my-bar --length 300mm --thickness '1 mm' --actuators '40mm,87 %' -o new.toml"
BENCH = "--port simulated --sensor simulated"
MEASURE = f"measure reference-a -o new.csv {BENCH}"
BY_CARD = "measure reference-a -o new.csv --port 'audio:simulated,full_scale=0.6 um,most=90 %' --sensor"
FIT = "calibrate reference-a m.csv -o new"
APPLY = "calibrate bar.toml new.csv -o new --starts 1 --measure --apply bar.nc"
SIMULATE = "simulate-measurements reference-a -o new.csv"
PLAY = "play reference-a --port nowhere --frequency 150 --amplitude '20 %'"
REFUSED = [
    ("build no-such-bar", "no-such-bar", "reference-a"),
    ("build bar.toml --pitch '0.5 mm'", "--pitch"),
    ("modes reference-a --up-to '3 Hz'", "--up-to", "no mode", "higher frequency"),
    ("effects curve reference-a --at 400mm", "--at", "279.4 mm"),
    (f"{NEW} --material cheese", "--material 'cheese'", "aluminium"),
    (f"{NEW} --actuators ,", "--actuators names no position"),
    (f"{NEW} --actuators 400mm", "off the bar", "300 mm"),
    (f"{NEW} --actuators some%", "--actuators 'some%'", "a length or a percentage"),
    (f"{NEW} --actuators 30x25mm", "--width", "--width 180mm"),
    (f"{NEW} -o bar.toml", "exists already and is not overwritten"),
    (NEW.replace("my-bar", "a/b"), "expected letters, digits"),
    (NEW.replace("my-bar", "x" * 65), "expected letters, digits"),
    ("plot reach bar.nc -o reach.png", "is a table of", "give the device file"),
    ("explain bar.nc --felt I --level nan", "--level", "0 to 80 dB"),
    ("explain bar.nc --felt I --drives zones --threshold android", "tactable build DEVICE --threshold android"),
    ("explain bar.nc --felt I --click --threshold android,8N", "--threshold android,8N", "leave --click"),
    ("fleet bars -o bars", "choose another folder"),
    ("fleet bars -o out --workers 2 --scheduler tcp://127.0.0.1:1", "--scheduler"),
    ("replay bar.toml", "bar.toml"),
    ("demo --recording missing.hid", "missing.hid"),
    ("plot state bar.nc --felt I -o state", "state", ".png, .svg, .pdf"),
    ("plot state bar.nc --felt I -o nowhere/state.png", "nowhere", "no such folder"),
    ("plot factor bar.nc --zones ,", "--zones names no zone"),
    ("plot factor bar.nc --zones I --amplitudes 1,0.3", "'1,0.3'", "0, 0.5, 1"),
    ("plot factor bar.nc --zones I --amplitudes 0,0", "nothing moves"),
    ("plot factor bar.nc --zones I --pair up,down", "'up,down'", "left,right"),
    ("plot response reference-a --drives 1,2 --measured x.csv", "--drives", "which has its own"),
    ("plot response reference-a --measured none.xyz", "none.xyz", ".csv"),
    ("plot response reference-a --by-zone --drives '1,2;1,3;1,4;1,5;1,6'", "5 drives", "one to 4"),
    ("plot response reference-a --by-zone --measured readings.csv", "--by-zone: give --drives", "no localized"),
    ("plot reach reference-a -o a.png -o b.svg", "a.png and b.svg", "give one of each"),
    ("export bar.nc sweep -o a.xls", "a.xls", ".nc, .csv, .mat"),
    ("study placement one.toml", "two fingers need two zones"),
    ("study placement bar.toml --actuators 2,5", "--actuators '2,5'", "1 to 4"),
    ("study resolution reference-p --at 16,97", "'16 %' is no point of the surface", "35x60mm"),
    ("study resolution bar.toml --at '16;16,16'", "'16,16'", "different places"),
    (f"{PLAY} --amplitude '120 %'", "0 to 100 % of full scale"),
    (f"{PLAY} --port audio:card", "full_scale is missing"),
    (f"{PLAY} --frequency 150,130,90", "one for each of left,right"),
    (f"{PLAY} --frequency=-,-", "no actuator moves"),
    (f"{PLAY} --phase 90", "such as 90deg"),
    ("measure reference-a -o new.csv --port simulated --sensor pipe", "simulate both or neither"),
    ("measure reference-a -o new.csv --port simulated --sensor board --flaws hum=1m/s^2", "is of a converter"),
    (
        "measure reference-a -o new.csv --port 'audio:Card,full_scale=0.6 um,most=50 %' --sensor board",
        "a sound card has no accelerometer",
    ),
    (f"{MEASURE} --most '120 %'", "at most 100 %"),
    (f"{MEASURE} --flaws noise=1", "has no unit"),
    (f"{BY_CARD} audio:simulated,scale=98.1m/s^2 --gravity", "a sound card passes no direct current"),
    (f"{MEASURE} --frequencies 60:300", "FROM:TO:STEP"),
    (f"{MEASURE} --frequencies 0:1e308:1e-300", "--frequencies '0:1e308:1e-300'", "60:300:1"),
    (f"{MEASURE} --frequencies 20", "choose some of a band"),
    ("emulate --sensor at=35mm", "give it by --device"),
    ("emulate --device reference-a --sensor mass=2g", "says no place"),
    ("emulate --device reference-a --sensor at=35mm,hiss=1", "known are at, mass, drift"),
    ("emulate --core nothing.so", "nothing.so is no library"),
    ("emulate --faults dorp=0.1", "'dorp'", "did you mean 'drop'"),
    ("bench latency --over 'audio:Card,full_scale=0.6 um,most=50 %'", "takes no part in this benchmark"),
    ("rollback bar.nc", "there is no previous table"),
    ("emulate --device reference-a --sensor at=35mm --core core.so", "leave --core out"),
    ("calibrate reference-a nowhere.txt -o new", "nowhere.txt"),
    (f"{FIT} --also bar.density=1", "--also bar.density=1", "1 kg/m^3..2 kg/m^3"),
    (f"{FIT} --also 'bar.density=1 kg..2 kg'", "--also bar.density: '1 kg' is a mass; expected a density"),
    (f"{FIT} --sensor-mass '-1 g'", "--sensor-mass '-1 g': expected at least 0"),
    (f"{FIT} --fit finger.mass --fit bar.density", "finger.mass: changes none of these readings"),
    ("build reference-a -o ''", ".: is a folder; give the name of a file"),
    ("new x --length 30cm --width 1cm --thickness 1mm --actuators 30%,70% -o ''", "name it x.toml"),
    ("doctor my-panel", "DEVICE: without --emit-udev"),
    (f"{FIT} --apply bar.nc", "not of 'reference-a' with its zones, actuators and limits"),
    ("calibrate bar.toml m.csv -o bars --apply bar.nc", "exists already and is not overwritten"),
    (f"{APPLY} --port simulated", "--measure needs --port and --sensor"),
    (f"{APPLY} {BENCH} --method chirp", "one of stepped, sweep"),
    (f"{APPLY} {BENCH} --most '0 %'", "expected more than 0"),
    (f"{SIMULATE} --drives=-,-", "frequencies in Hz of left,right"),
    (f"{SIMULATE} --drives 150,x", "'x': expected a frequency of at most"),
    (f"{SIMULATE} --drives ';'", "--drives names no drive"),
    (f"{SIMULATE} --change bar.density", "--change bar.density: '' is not a number with a unit"),
]


@pytest.fixture(scope="module")
def folder(click_table: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("refused")
    shutil.copy(click_table, folder)
    shutil.copy(device_folder().parent / "measurements" / "reference-a-drifted.csv", folder / "m.csv")
    (folder / "bar.toml").write_text(SMALL, encoding="utf-8")
    (folder / "one.toml").write_text(ONE_LEVEL.replace("count = 3", "count = 1"), encoding="utf-8")
    write_unit(folder / "bars" / "one", small_text())
    return folder


@pytest.mark.parametrize("case", REFUSED, ids=[case[0] for case in REFUSED])
def test_a_refusal_is_one_line_that_names_the_thing_and_the_remedy(folder: Path, case: tuple[str, ...]) -> None:
    words, *parts = case
    before = {path.name: path.stat().st_mtime_ns for path in folder.rglob("*")}
    done = run_here(folder, *shlex.split(words))
    assert (done.returncode, done.stdout) == (1, "")
    *said, line = done.stderr.splitlines()
    assert line.startswith("tactable: ") and all("SIMULATED" in each for each in said), done.stderr
    assert all(part in line for part in parts), line
    assert {path.name: path.stat().st_mtime_ns for path in folder.rglob("*")} == before
