"""Fingerprint of the code that a table's numbers depend on.

Covered is what `precompute.builder.build` imports, directly or through other modules of this project: the model, the
sweeps, sampling, clicks, the device and the table format, with the wire constants that they use. A name that a
package re-exports leads to the module that defines it, not to the whole package.

Comments, docstrings and layout do not count, since each source is hashed as its syntax tree without them. So a changed
docstring makes no table stale, and a changed number always does. Nor does the version of Python count: each adds fields
to its trees, which are empty in code that older ones can read, and writes quotation marks in f-strings in its own way.
"""

import ast
import hashlib
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

_ROOTS = ("precompute", "engine", "firmware_link", "base")
_START = "precompute.builder.build"
_WITHOUT_NUMBERS = (
    "precompute.parallel",  # which process solves, not what
    "base.compiled",  # which machine code is kept, not what it computes
    "engine.touch.descriptor",  # how the live engine reads fingers; a table needs only the states of zones
    "engine.touch.digitizer",
    "firmware_link.host",  # what a port answers while it is open
)


@cache
def code_fingerprint() -> str:
    """SHA-256 (hex) over the sources of `numeric_modules`."""
    return fingerprint_of({name: path.read_text(encoding="utf-8") for name, path in numeric_modules().items()})


def fingerprint_of(sources: Mapping[str, str]) -> str:
    """SHA-256 (hex) over Python sources by module name, without comments, docstrings and layout."""
    digest = hashlib.sha256()
    for name, source in sorted(sources.items()):
        digest.update(f"{name}\0{_nested(_Bare().visit(ast.parse(source)))!r}\0".encode())
    return digest.hexdigest()


def numeric_modules() -> dict[str, Path]:
    """The modules whose sources count, by name."""
    found, waiting = dict[str, Path](), [_START]
    while waiting:
        name = waiting.pop()
        path = _path_of(name)
        if path is None or name in found or name.startswith(_WITHOUT_NUMBERS):
            continue
        found[name] = path
        waiting += _imported(ast.parse(path.read_text(encoding="utf-8")))
    return found


def _imported(tree: ast.Module) -> Iterator[str]:
    """Names of this project's modules that a module takes something from."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (each.name for each in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            yield from (_home(node.module, each.name) for each in node.names)


def _home(module: str, name: str) -> str:
    """The module that `from module import name` leads to: through the `__init__` of a package to where the name is."""
    path = _path_of(module)
    if path is None or path.name != "__init__.py":
        return module
    if _path_of(f"{module}.{name}") is not None:
        return f"{module}.{name}"
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ImportFrom) and node.module is not None:
            for each in node.names:
                if name == (each.asname or each.name):
                    return _home(node.module, each.name)
    return module


@cache
def _path_of(module: str) -> Path | None:
    """Where a module's source is; None for modules that are not this project's."""
    if module.partition(".")[0] not in _ROOTS:
        return None
    base = Path(__file__).parents[2].joinpath(*module.split("."))
    return next((path for path in (base.with_suffix(".py"), base / "__init__.py") if path.is_file()), None)


def _nested(part: Any) -> Any:
    """A syntax tree as lists: the kind of each node, then its fields that are not empty."""
    if isinstance(part, list):
        return [_nested(each) for each in part]
    if not isinstance(part, ast.AST):
        return part
    fields = [(name, _nested(value)) for name, value in ast.iter_fields(part) if value is not None and value != []]
    return [type(part).__name__, *fields]


class _Bare(ast.NodeTransformer):
    """Removes every statement that is only a string, and so all docstrings; and the empty parts of f-strings."""

    def visit_Expr(self, node: ast.Expr) -> ast.Expr | None:  # the name that ast calls
        is_text = isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
        return None if is_text else node

    def visit_JoinedStr(self, node: ast.JoinedStr) -> ast.AST:  # Python 3.12 ends a nested format with ""
        node.values = [each for each in node.values if not (isinstance(each, ast.Constant) and each.value == "")]
        return self.generic_visit(node)
