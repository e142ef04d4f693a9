"""The notebooks in docs/notebooks/ come to what they are kept with; `python -m tests.test_notebooks` keeps outputs."""

import os
import re
import shutil
import tempfile
from pathlib import Path
from typing import Any

import nbformat
import pytest
from nbclient import NotebookClient

from tests.documents import ROOT

NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))
_HANGS_S = 1200
_FIGURE = re.compile(r"<Figure size .*?>|<matplotlib\..*?>|0x[0-9a-f]+")
_NUMBER = re.compile(r"-?\d+\.\d*(?:e[-+]\d+)?\s*")  # numpy fills them up with spaces


def read_notebook(path: Path) -> Any:
    return nbformat.read(path, as_version=4)  # type: ignore[no-untyped-call]  # has no types


def run_notebook(path: Path, folder: Path) -> Any:
    """The notebook after a run in a checkout's place for it, made in `folder`."""
    os.environ |= {"MPLBACKEND": "module://matplotlib_inline.backend_inline", "IPYTHONDIR": str(folder / "ipython")}
    here = folder / "docs" / "notebooks"
    here.mkdir(parents=True)
    (folder / "tables").symlink_to(ROOT / "tables")
    shutil.copy(path, here)
    notebook = read_notebook(here / path.name)
    NotebookClient(notebook, timeout=_HANGS_S, resources={"metadata": {"path": str(here)}}).execute()
    for cell in notebook.cells:
        cell.get("metadata", {}).clear()
    return notebook


def texts_of(notebook: Any) -> tuple[list[str], list[float]]:
    """What each cell prints or shows as text, and the numbers that were taken out: their last digits may be another's.

    Another processor rounds otherwise, which moves a click by a thousandth.
    """
    found, numbers = [], list[float]()
    for cell in notebook.cells:
        outputs = cell.get("outputs", [])
        shown = [each.get("text", "") or each.get("data", {}).get("text/plain", "") for each in outputs]
        text = _FIGURE.sub("", "\n".join(shown))
        numbers += map(float, _NUMBER.findall(text))
        found.append(_NUMBER.sub("number", text))
    return found, numbers


def pictures_of(notebook: Any) -> int:
    """How many pictures its cells have drawn."""
    return sum("image/png" in each.get("data", {}) for cell in notebook.cells for each in cell.get("outputs", []))


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


def main() -> None:
    """Run every notebook and keep its outputs."""
    for path in NOTEBOOKS:
        with tempfile.TemporaryDirectory() as folder:
            nbformat.write(run_notebook(path, Path(folder)), path)  # type: ignore[no-untyped-call]  # has no types


if __name__ == "__main__":
    main()
