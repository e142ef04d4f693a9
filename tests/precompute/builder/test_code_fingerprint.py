"""What makes tables stale: every module that numbers come from, and nothing else of the project."""

from functools import cache
from pathlib import Path

import grimp
import pytest

from precompute.builder.code_fingerprint import code_fingerprint, fingerprint_of, numeric_modules

HOUSE = ("precompute", "engine", "firmware_link", "base")


@cache
def sources() -> dict[str, str]:
    return {name: path.read_text(encoding="utf-8") for name, path in numeric_modules().items()}


def counts(module: str, before: str, after: str) -> bool:
    """Whether the fingerprint changes where one text of one module does; that of all modules is made of their own."""
    source = sources()[module]
    assert before in source
    return fingerprint_of({module: source}) != fingerprint_of({module: source.replace(before, after, 1)})


def test_every_module_that_a_build_loads_counts_but_for_the_processes_that_solve() -> None:
    graph = grimp.build_graph("precompute", "engine", "firmware_link", "base", cache_dir=None)
    loaded = {
        name for name in graph.find_upstream_modules("precompute.builder.table_build") if name.startswith("precompute.")
    }
    uncounted = {name for name in loaded - set(numeric_modules()) if not graph.find_children(name)}
    assert {name.rpartition(".")[0] for name in uncounted} <= {"precompute.parallel"}
    assert len(loaded) > 30


def test_what_numbers_come_from_counts_and_what_none_comes_from_does_not() -> None:
    counted = {
        "engine.device.uncertainty",
        "engine.device.parts",
        "engine.table.netcdf_file",
        "engine.touch.finger_tracker",
    }
    assert counted | {"precompute.builder.table_build", "firmware_link.protocol.messages"} <= sources().keys()
    precompute = ("precompute.studies", "precompute.fleet", "precompute.parallel")
    engine = ("engine.loop", "engine.render", "engine.effects", "engine.touch.digitizer", "engine.touch.quirks")
    others = (*precompute, *engine, "base.compiled", "firmware_link.emulator", "tactable")
    assert [name for name in sources() if name.startswith(others) or not name.startswith(HOUSE)] == []


def test_a_changed_number_makes_tables_stale() -> None:
    assert counts("engine.device.uncertainty", "_ROUNDING = 1e-9", "_ROUNDING = 1e-8")
    assert counts("precompute.sampling.steady_modes", "PITCH_M = 5e-3", "PITCH_M = 4e-3")
    two = {name: sources()[name] for name in ("engine.device.parts", "precompute.clicks.closed_form")}
    assert fingerprint_of(two | {"precompute.clicks.closed_form": "changed = 1"}) != fingerprint_of(two)
    assert fingerprint_of(sources()) == code_fingerprint()


def test_comments_docstrings_and_blank_lines_make_no_table_stale() -> None:
    assert not counts("engine.device.uncertainty", "import math\n", "\n\nimport math  # for its roots\n")
    assert not counts("precompute.sampling.plants", '"""', '"""Said differently: ')
    assert not counts("precompute.sweep.sweep_kernels", '"""', '"""Once more: ')


def test_every_version_of_python_comes_to_the_same() -> None:
    """The digest is what Python 3.11, 3.12 and 3.13 come to, whose trees of f-strings differ."""
    source = "def f(a, *b, c=None, **d):\n    return None if a else f\"{d['key']!r:>{c}} it's \\n {{}}\", {**d}\n"
    digest = "4363f5792290ebe3824f4e99370b962d702fea5b5ebefc78d8cba2f8db6b9d9b"
    assert fingerprint_of({"m": source}) == digest


def test_what_is_kept_counts_for_the_same_sources_alone_and_is_kept_where_it_can_be(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    find, kept = code_fingerprint.__wrapped__, tmp_path / "tactable" / "code-fingerprint"
    found = find()
    sources, said = kept.read_text().split()
    assert found == said == code_fingerprint()
    kept.write_text(f"{sources} {'0' * 64}\n")
    assert find() == "0" * 64
    for other in (f"{'0' * 64} {'0' * 64}\n", "damaged", ""):
        kept.write_text(other)
        assert find() == found and kept.read_text().split() == [sources, found]
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert find() == found
