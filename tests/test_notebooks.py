"""The notebooks in docs/notebooks/ run from a clean kernel, and come to what they are kept with."""

from pathlib import Path

import pytest

from tests.notebooks import NOTEBOOKS, pictures_of, read_notebook, run_notebook, texts_of


@pytest.mark.machine(stall_s=None)
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_it_comes_to_what_it_is_kept_with(path: Path, tmp_path: Path) -> None:
    kept, found = read_notebook(path), run_notebook(path, tmp_path)
    (texts, numbers), (kept_texts, kept_numbers) = texts_of(found), texts_of(kept)
    assert texts == kept_texts
    assert numbers == pytest.approx(kept_numbers, rel=5e-3, abs=2e-3)
    assert pictures_of(found) == pictures_of(kept) >= 2


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_it_is_kept_with_its_pictures_and_imports_public_names_only(path: Path) -> None:
    code = "\n".join(cell.source for cell in read_notebook(path).cells if cell.cell_type == "code")
    assert "from tactable import" in code
    assert pictures_of(read_notebook(path)) >= 2
    assert not any(name in code for name in ("engine.", "precompute.", "firmware_link.", "tactable."))
