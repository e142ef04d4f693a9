"""Mutants of a source file: the same text with one operator, number, condition, return or statement changed.

A mutant is worth a run only if it may behave differently. So what people read (comments, docstrings, annotations, the
texts of errors) is left alone. Python is changed by its syntax tree, C by its tokens: binary operators have a space on
both sides in our C, pointers do not.
"""

import ast
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

_OPERATORS = {
    "<": ("<=", ">="),
    "<=": ("<", ">"),
    ">": (">=", "<="),
    ">=": (">", "<"),
    "==": ("!=",),
    "!=": ("==",),
    "is": ("is not",),
    "is not": ("is",),
    "in": ("not in",),
    "not in": ("in",),
    "&&": ("||",),
    "||": ("&&",),
    "+": ("-",),
    "-": ("+",),
    "*": ("/",),
    "/": ("*",),
    "//": ("*",),
    "%": ("*",),
    "&": ("|",),
    "|": ("&",),
    "<<": (">>",),
    ">>": ("<<",),
    "+=": ("-=", "="),
    "-=": ("+=", "="),
}
_SWAPPED_CALLS = {"min": "max", "max": "min", "floor": "ceil", "ceil": "floor", "any": "all", "all": "any"}

_C_SILENT = re.compile(
    r'/\*.*?\*/|//[^\n]*|"(?:\\.|[^"\\])*"|^[ \t]*#[ \t]*(?:include|ifn?def|endif|if|else)[^\n]*', re.S | re.M
)
_C_BINARY = re.compile(r"(?<= )(?:<<|>>|<=|>=|==|!=|&&|\|\||\+=|-=|[-+*/%&|<>])(?= )")
_C_NUMBER = re.compile(r"(?<![\w.])(\d+)(u?)(?![\w.])")
_C_CONDITION = re.compile(r"\bif (?=\()")
_C_RETURN = re.compile(r"(?<=\breturn )(?!0;)[^;]+(?=;)")
_C_STATEMENT = re.compile(r"(?<=  )(?:[*a-z_][\w\->.\[\]]* [-+|&]?= [^;{]+|[a-z_]\w*\([^;{]*\)|[\w\->.]+\+\+);$", re.M)
_C_WORDS = {r"\btrue\b": "false", r"\bfalse\b": "true", r"!(?=[\w(])": "", r"\b(?:break|continue);": ";"}


@dataclass(frozen=True)
class Mutant:
    """One change of a file: the text from `start` to `stop` replaced by `after`."""

    path: str
    start: int
    stop: int
    line: int
    after: str
    name: str
    """What it is called in results: the path, the line it stands in and the change; the same while that line lives."""

    def apply(self, text: str) -> str:
        return text[: self.start] + self.after + text[self.stop :]


def mutants_of(path: str, text: str) -> list[Mutant]:
    """All mutants of a .py or .c file, in the order of their places, each once."""
    changes = _python_changes(text) if path.endswith(".py") else _c_changes(text)
    found, names = list[Mutant](), Counter[str]()
    for start, stop, after in sorted(set(changes)):
        begin, end = text.rfind("\n", 0, start) + 1, text.find("\n", start)
        context, line = text[begin:end], text.count("\n", 0, start) + 1
        column = start - begin - (len(context) - len(context.lstrip()))
        code = context.partition("  #")[0].strip()
        name = f"{path}: {code} [{column}: {' '.join(text[start:stop].split())} -> {after}]"
        names[name] += 1
        if text[start:stop] != after:
            found.append(Mutant(path, start, stop, line, after, name if names[name] == 1 else f"{name} #{names[name]}"))
    return found


def _python_changes(text: str) -> Iterator[tuple[int, int, str]]:
    lines = [0]
    for line in text.splitlines(keepends=True):
        lines.append(lines[-1] + len(line.encode()))
    encoded = text.encode()

    def place(line: int, column: int) -> int:
        return len(encoded[: lines[line - 1] + column].decode())

    for node, is_local in _telling(ast.parse(text)):
        assert isinstance(node, ast.expr | ast.stmt) and node.end_lineno and node.end_col_offset is not None
        start, stop = place(node.lineno, node.col_offset), place(node.end_lineno, node.end_col_offset)
        for after in _python_alternatives(node):
            # Without a definition everything fails: that proves nothing.
            if after != "pass" or (is_local and not _defines_name(node)):
                yield start, stop, after


def _defines_name(node: ast.AST) -> bool:
    return isinstance(node, ast.Assign) and all(isinstance(target, ast.Name | ast.Tuple) for target in node.targets)


def _telling(node: ast.AST, is_local: bool = False) -> Iterator[tuple[ast.expr | ast.stmt, bool]]:
    """What decides something, and whether it is in a function: no annotations, texts, imports and messages."""
    if isinstance(node, ast.JoinedStr | ast.Import | ast.ImportFrom | ast.arguments):
        return
    if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
        return
    if isinstance(node, ast.expr | ast.stmt):
        yield node, is_local
    is_local = is_local or isinstance(node, ast.FunctionDef)
    skipped = {"annotation", "returns", "decorator_list", "bases", "exc", "cause", "msg"}
    for field, value in ast.iter_fields(node):
        if field not in skipped:
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST):
                    yield from _telling(child, is_local)


def _python_alternatives(node: ast.expr | ast.stmt) -> Iterator[str]:
    match node:
        case ast.Compare():
            for index, operator in enumerate(node.ops):
                for after in _OPERATORS[_symbol(operator)]:
                    yield _compared(node, index, after)
        case ast.BinOp() if _symbol(node.op) in _OPERATORS:
            yield f"({ast.unparse(node.left)}) {_OPERATORS[_symbol(node.op)][0]} ({ast.unparse(node.right)})"
        case ast.BoolOp():
            other = " or " if isinstance(node.op, ast.And) else " and "
            yield "(" + other.join(f"({ast.unparse(value)})" for value in node.values) + ")"
        case ast.UnaryOp(op=ast.Not() | ast.USub()):
            yield f"({ast.unparse(node.operand)})"
        case ast.Constant(value=bool()):
            yield str(not node.value)
        case ast.Constant(value=int(number)):
            yield from (repr(number + 1), repr(number - 1))
        case ast.Constant(value=float(number)):
            yield from (repr(number + 1.0), "0.0")
        case ast.Call(func=ast.Name(id=name) | ast.Attribute(attr=name)) if name in _SWAPPED_CALLS:
            swapped = ast.unparse(node.func).removesuffix(name) + _SWAPPED_CALLS[name]
            yield f"{swapped}({', '.join(map(ast.unparse, (*node.args, *node.keywords)))})"
        case ast.IfExp():
            yield f"({ast.unparse(node.orelse)} if {ast.unparse(node.test)} else {ast.unparse(node.body)})"
        case ast.Return(value=ast.expr() as value) if not (isinstance(value, ast.Constant) and value.value is None):
            yield "return None"
        case ast.Expr(value=ast.Call()) | ast.Assign() | ast.AugAssign() | ast.Raise() | ast.Continue() | ast.Break():
            yield "pass"


def _compared(node: ast.Compare, index: int, after: str) -> str:
    terms = [ast.unparse(each) for each in (node.left, *node.comparators)]
    operators = [_symbol(each) for each in node.ops]
    operators[index] = after
    return "(" + f"({terms[0]})" + "".join(f" {o} ({t})" for o, t in zip(operators, terms[1:], strict=True)) + ")"


def _symbol(operator: ast.cmpop | ast.operator) -> str:
    x = ast.Name("x")
    applied = ast.BinOp(x, operator, x) if isinstance(operator, ast.operator) else ast.Compare(x, [operator], [x])
    return ast.unparse(applied).strip("x ")


def _c_changes(text: str) -> Iterator[tuple[int, int, str]]:
    # What says nothing to the compiler becomes spaces, so that places stay.
    code = _C_SILENT.sub(lambda found: re.sub(r"[^\n]", " ", found[0]), text)
    for found in _C_BINARY.finditer(code):
        for after in _OPERATORS[found[0]]:
            yield *found.span(), after
    for found in _C_NUMBER.finditer(code):
        yield *found.span(), f"{int(found[1]) + 1}{found[2]}"
        if int(found[1]) > 0:
            yield *found.span(), f"{int(found[1]) - 1}{found[2]}"
    for found in _C_CONDITION.finditer(code):
        stop = _closing(code, found.end())
        yield found.end(), stop, f"(!{text[found.end() : stop]})"
    for found in _C_RETURN.finditer(code):
        yield *found.span(), "0"
    for found in _C_STATEMENT.finditer(code):
        yield *found.span(), ";"
    for pattern, after in _C_WORDS.items():
        for found in re.finditer(pattern, code):
            yield *found.span(), after


def _closing(code: str, start: int) -> int:
    """The place behind the parenthesis that closes the one at `start`."""
    depth = 0
    for place in range(start, len(code)):
        depth += {"(": 1, ")": -1}.get(code[place], 0)
        if depth == 0:
            return place + 1
    raise ValueError(f"no closing parenthesis after place {start}")
