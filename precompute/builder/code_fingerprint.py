"""Fingerprint of the code that a table's numbers depend on.

Covered is what `precompute.builder.table_build` imports, directly or through other modules of this project: the model,
the sweeps, sampling, clicks, the device and the table format, with the wire constants that they use. A name that a
package re-exports leads to the module that defines it, not to the whole package.

Comments, docstrings and layout do not count, since each source is hashed as its syntax tree without them. So a changed
docstring makes no table stale, and a changed number always does. Nor does the version of Python count: each adds fields
to its trees, which are empty in code that older ones can read, and writes quotation marks in f-strings in its own way.
"""

import ast
import hashlib
import os
from collections.abc import Iterator, Mapping
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from base.files import replace_file

_ROOTS = ("precompute", "engine", "firmware_link", "base")
_START = "precompute.builder.table_build"
_WITHOUT_NUMBERS = (
    "precompute.parallel",  # which process solves, not what
    "base.compiled",  # which machine code is kept, not what it computes
    "engine.touch.descriptor",  # how the live engine reads fingers; a table needs only the states of zones
    "engine.touch.digitizer",
    "firmware_link.host",  # what a port answers while it is open
)


_BLOCKS = ("body", "orelse", "finalbody", "handlers", "cases")  # fields of a statement that hold statements


class _Module(NamedTuple):
    """What is kept of a source. Syntax trees are not: the garbage collector would walk those of a hundred modules."""

    digest: str
    imports: list[tuple[str, str | None, str | None]]
    """Modules, what is taken from them (None: the module itself), and the other name that it gets."""


@cache
def code_fingerprint() -> str:
    """SHA-256 (hex) over the sources of `numeric_modules`; kept for the bytes of all sources, since it takes 0.4 s."""
    folder = Path(__file__).parents[2]
    digest = hashlib.sha256()
    for path in sorted(path for root in _ROOTS for path in (folder / root).rglob("*.py")):
        digest.update(f"{path.relative_to(folder)}\0".encode() + path.read_bytes() + b"\0")
    kept = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "tactable" / "code-fingerprint"
    with suppress(OSError, ValueError):
        sources, found = kept.read_text(encoding="ascii").split()
        if sources == digest.hexdigest():
            return found
    found = _joined({name: _read(path).digest for name, path in numeric_modules().items()})
    with suppress(OSError):  # a machine without a folder to write in finds it each time
        kept.parent.mkdir(parents=True, exist_ok=True)
        with replace_file(kept) as partial:
            partial.write_text(f"{digest.hexdigest()} {found}\n", encoding="ascii")
    return found


def fingerprint_of(sources: Mapping[str, str]) -> str:
    """SHA-256 (hex) over Python sources by module name, without comments, docstrings and layout."""
    return _joined({name: _parse(source).digest for name, source in sources.items()})


def _joined(digests: Mapping[str, str]) -> str:
    lines = (f"{name} {digest}\n" for name, digest in sorted(digests.items()))
    return hashlib.sha256("".join(lines).encode()).hexdigest()


def numeric_modules() -> dict[str, Path]:
    """The modules whose sources count, by name."""
    found, waiting = dict[str, Path](), [_START]
    while waiting:
        name = waiting.pop()
        path = _path_of(name)
        if path is None or name in found or name.startswith(_WITHOUT_NUMBERS):
            continue
        found[name] = path
        waiting += (_home(module, taken) for module, taken, _ in _read(path).imports)
    return found


def _home(module: str, name: str | None) -> str:
    """The module that `from module import name` leads to: through the `__init__` of a package to where the name is."""
    path = _path_of(module)
    if name is None or path is None or path.name != "__init__.py":
        return module
    if _path_of(f"{module}.{name}") is not None:
        return f"{module}.{name}"
    for origin, taken, other_name in _read(path).imports:
        if taken is not None and name == (other_name or taken):
            return _home(origin, taken)
    return module


@cache
def _path_of(module: str) -> Path | None:
    """Path of a module's source; None for modules that are not this project's."""
    if module.partition(".")[0] not in _ROOTS:
        return None
    base = Path(__file__).parents[2].joinpath(*module.split("."))
    return next((path for path in (base.with_suffix(".py"), base / "__init__.py") if path.is_file()), None)


@cache
def _read(path: Path) -> _Module:
    return _parse(path.read_text(encoding="utf-8"))


def _parse(source: str) -> _Module:
    tree = ast.parse(source)
    return _Module(hashlib.sha256(repr(_nested(tree)).encode()).hexdigest(), list(_imported(tree)))


def _imported(tree: ast.Module) -> Iterator[tuple[str, str | None, str | None]]:
    waiting: list[ast.AST] = [tree]
    while waiting:  # statements alone, which are a tenth of the nodes
        node = waiting.pop()
        waiting += (each for field in _BLOCKS for each in getattr(node, field, ()))
        if isinstance(node, ast.Import):
            yield from ((each.name, None, each.asname) for each in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            yield from ((node.module, each.name, each.asname) for each in node.names)


def _nested(part: Any) -> Any:
    """A syntax tree as lists, without docstrings: the kind of each node, then its fields that are not empty."""
    if isinstance(part, list):
        return [_nested(each) for each in part if not _is_text(each)]
    if not isinstance(part, ast.AST):
        return part
    if isinstance(part, ast.JoinedStr):  # Python 3.12 ends a nested format with ""
        part.values = [each for each in part.values if not (isinstance(each, ast.Constant) and each.value == "")]
    fields = ((name, getattr(part, name)) for name in part._fields)
    return [
        type(part).__name__,
        *((name, _nested(value)) for name, value in fields if value is not None and value != []),
    ]


def _is_text(node: Any) -> bool:
    """Whether a node is a statement that is only a string, as docstrings are."""
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
