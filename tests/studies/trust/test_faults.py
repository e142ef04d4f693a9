"""A quick run of the fault injection; `python -m tests.studies.trust.faults` is the long one."""

import subprocess
from pathlib import Path

import pytest

from tests.firmware_link.firmware.compiled_core import need
from tests.studies.trust import faults
from tests.studies.trust.faults import conditions, inject

CASES = conditions(before_kib=8)
WRITING = "import os, pathlib, sys; pathlib.Path(os.environ['OUT'], 'half').write_text('x'); {after}"


BAD_WRITERS = {
    "sys.exit('tactable: no')": "left or changed",
    "sys.exit(7)": "exit status 7",
    "raise OSError": "no single line",
    "os.abort()": "exit status",
}


@pytest.mark.machine(stall_s=None)
def test_a_writer_that_cannot_write_says_so_in_one_line_and_leaves_nothing_and_a_bad_one_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    need("unshare", "setpriv")
    if subprocess.run(["unshare", "-rm", "true"], capture_output=True, check=False).returncode:
        pytest.skip("this user may not have a mount namespace")
    for name in ("kept.txt", "table.nc"):
        (tmp_path / name).write_text("as before\n", encoding="utf-8")
    for fault in ("disk full, 0 KiB left", "read-only", "no permission"):
        assert inject("new", CASES[fault], tmp_path) == ("refused", ""), fault
    for after, wrong in BAD_WRITERS.items():
        monkeypatch.setattr(faults, "_COMMAND", WRITING.format(after=after))
        outcome, said = inject("new", CASES["disk full, 64 KiB left"], tmp_path)
        assert outcome == "refused" and wrong in said, after
