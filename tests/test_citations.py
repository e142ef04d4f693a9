"""What code and documents point to exists: files, headings, modules, and the functions named on the pages."""

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ROOMS = ("base", "engine", "precompute", "firmware_link", "tactable", "tests", "docs", "tables")
SOURCES = (".py", ".c", ".h", ".js", ".html", ".md", ".toml", ".ipynb", ".cpp")
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")), *sorted((ROOT / "tables").glob("*.md"))]
_CITED = re.compile(r"(?<![\w/.-])((?:[\w-]+/)*[A-Za-z][\w-]*\.md)(?:#([\w-]+))?")
_NAMED = re.compile(r"\[`([\w.]+)`\]\(([^)#]+\.(?:py|c|h))\)")
_MADE_BY_COMMANDS = {"report.md"}
_MODULE = re.compile(r"(?<![\w./-])((?:base|engine|precompute|firmware_link|tactable|tests)(?:\.[A-Za-z_]\w*)+)")
_PATH = re.compile(r"(?<![\w./-])((?:base|engine|precompute|firmware_link|tactable|tests|tables|docs)(?:/[\w.-]*\w)+)")


def sources() -> Iterator[Path]:
    for room in ROOMS:
        yield from (path for path in sorted((ROOT / room).rglob("*")) if path.suffix in SOURCES)
    yield from (ROOT / name for name in ("README.md", "CHANGELOG.md"))


def anchors(page: Path) -> set[str]:
    headings = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    plain = (re.sub(r"[^\w\- ]", "", heading.lower()) for heading in headings)
    return {heading.replace(" ", "-") for heading in plain}


def page_of(cited: str, where: Path) -> Path | None:
    """The page that a citation means: beside the file, from the root, in a folder of documents, or anywhere by name."""
    folders = (where.parent, ROOT, ROOT / "docs", ROOT / "tables", ROOT / "firmware_link")
    found = (folder / cited for folder in folders if (folder / cited).is_file())
    return next(found, None)


def missing_citations(where: Path) -> list[str]:
    text, missing = where.read_text(encoding="utf-8"), []
    for cited, anchor in _CITED.findall(text):
        page = page_of(cited, where)
        if Path(cited).name in _MADE_BY_COMMANDS:
            continue
        if page is None or (anchor and anchor not in anchors(page)):
            missing.append(f"{where.relative_to(ROOT)}: {cited}{'#' * bool(anchor)}{anchor}")
    links = re.findall(r"\]\(([^)#:\s]*)#([^)\s]+)\)", text) if where.suffix == ".md" else ()
    targets = [((where.parent / path).resolve() if path else where, anchor) for path, anchor in links]
    return missing + [f"{where.name}: {page.name}#{anchor}" for page, anchor in targets if anchor not in anchors(page)]


def defined_names(path: Path) -> set[str]:
    """Functions and classes of a file, methods as Class.method; of C whatever is defined or declared with a body."""
    text = path.read_text(encoding="utf-8")
    if path.suffix != ".py":
        return set(re.findall(r"^\w[\w *]*?\b(\w+)\([^;]*?\)\s*\{", text, re.MULTILINE))
    names = set[str]()
    for node in ast.parse(text).body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            names.add(node.name)
        if isinstance(node, ast.ClassDef):
            names.update(f"{node.name}.{part.name}" for part in node.body if isinstance(part, ast.FunctionDef))
    return names


def prose_of(path: Path) -> str:
    """What a person reads of a file: of Python its comments and docstrings, of others all of it."""
    text = path.read_text(encoding="utf-8")
    if path.suffix != ".py":
        return text
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    texts = (node.value for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Expr))
    said = [text.value for text in texts if isinstance(text, ast.Constant) and isinstance(text.value, str)]
    return "\n".join([*said, *(token.string for token in tokens if token.type == tokenize.COMMENT)])


@cache
def is_there(dotted: str) -> bool:
    """Whether a dotted name leads to a module, or to a module that names what follows."""
    parts = dotted.split(".")
    for length in range(len(parts), 0, -1):
        base = ROOT.joinpath(*parts[:length])
        module = next((path for path in (base.with_suffix(".py"), base / "__init__.py") if path.is_file()), None)
        if module is not None:
            rest = parts[length:]
            return not rest or re.search(rf"\b{rest[0]}\b", module.read_text(encoding="utf-8")) is not None
    return False


@cache
def retired() -> frozenset[str]:
    """The studies that docs/results.md says are in the history alone."""
    section = (ROOT / "docs" / "results.md").read_text(encoding="utf-8").partition("## Retired studies")[2]
    return frozenset(f"tests.studies.{name}" for name in re.findall(r"`([a-z]+\.[a-z_]+)`", section))


def missing_names(text: str) -> list[str]:
    """The modules and paths that a text names and that are not there, nor retired."""
    modules = [name for name in _MODULE.findall(text) if not is_there(name) and name not in retired()]
    return modules + [name for name in _PATH.findall(text) if not (ROOT / name).exists()]


def test_every_module_and_every_path_that_is_named_exists() -> None:
    missing = []
    for path in sources():
        # The changelog also names what is gone. Finding the prose of a file takes long, and few files need it.
        if path.name != "CHANGELOG.md" and missing_names(path.read_text(encoding="utf-8")):
            missing += [f"{path.relative_to(ROOT)}: {name}" for name in missing_names(prose_of(path))]
    assert missing == []


def test_a_module_a_name_and_a_document_that_is_gone_is_found(tmp_path: Path) -> None:
    assert all(map(is_there, ("engine.loop.pipeline", "engine.loop.pipeline.Pipeline", "tactable.Device.read")))
    assert not is_there("engine.loop.vanished") and not is_there("engine.loop.pipeline.vanished")
    assert page_of("PHYSICS.md", tmp_path / "module.py") is None
    assert page_of("docs/theory.md", tmp_path / "module.py") == ROOT / "docs" / "theory.md"
    assert "objective-and-bound" in anchors(ROOT / "docs" / "theory.md")


def test_every_document_and_heading_that_is_cited_exists() -> None:
    missing = [citation for path in sources() if path != Path(__file__) for citation in missing_citations(path)]
    assert missing == []


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.name)
def test_every_function_that_a_page_names_is_in_the_file_it_links_to(page: Path) -> None:
    named = [
        (name, page.parent / target)
        for name, target in _NAMED.findall(page.read_text(encoding="utf-8"))
        if name != Path(target).name and "/" not in name
    ]
    assert [f"{name} in {path}" for name, path in named if name not in defined_names(path)] == []


def test_the_journeys_name_functions_of_every_room_they_pass() -> None:
    named = _NAMED.findall((ROOT / "docs" / "journey.md").read_text(encoding="utf-8"))
    rooms = {Path(target).parts[1] for _, target in named}
    assert rooms == {"engine", "firmware_link", "precompute", "tactable"} and len(named) > 25
