"""The process that builds the page's table ends without a word whenever it is asked to."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.quick import first_quick

ASKED_TO_END_AFTER_ITS_LAST_WORD = """
import signal
import sys
from pathlib import Path
from types import SimpleNamespace

from tactable.page.processes import build

asked = {"device": "reference-a", "path": sys.argv[1], "first": sys.argv[1] + ".first"}
is_there = sys.argv[2] == "there"
build.compile_for_clicks = build.compile_all = lambda *_: None
build.write_first_table = lambda *_: None
build.open_cached = lambda *_: SimpleNamespace(path=Path(asked["path"])) if is_there else None
if not is_there:
    import precompute.builder.build

    precompute.builder.build.build_table = lambda _, path, **__: path.touch()


class Page:
    def end_with_it(self):
        pass

    def say(self, document):
        print(document)


build.main(Page(), asked)
signal.raise_signal(signal.SIGTERM)
print("went on")
"""


@pytest.mark.machine
@pytest.mark.parametrize("table", first_quick(["there", "built"]))
def test_it_is_ended_by_a_signal_that_comes_as_it_ends(table: str, tmp_path: Path) -> None:
    path = tmp_path / "table.nc"
    ended = subprocess.run(
        [sys.executable, "-c", ASKED_TO_END_AFTER_ITS_LAST_WORD, str(path), table],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (ended.returncode, ended.stderr) == (-signal.SIGTERM, ""), ended
