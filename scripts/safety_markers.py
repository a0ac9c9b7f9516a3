"""Statements that keep a safety rule: marked by comments `# safety: NAME`, found and broken in the syntax tree.

A marker at the end of a line marks the statement of that line; one on a line of its own, the statement that follows.
Several names may stand in one marker: `# safety: one, other`. `except …:` counts as a statement, and `elif …:` as one
with all that follows it in its `if`.

A mutation says in words how a marked statement is broken. None needs the names that the code happens to use:

- `drop`                      the statement becomes `pass`
- `return`                    the statement becomes `return`
- `never`, `always`           its condition (of `if`, `while`, `… if … else …`) becomes False or True
- `uncaught`                  its `except` catches nothing
- `only N`, `without N`       one operand is kept, or left out: of the outermost and/or, else of the outermost call
- `only N of PART`, `without N of PART`    an operand of this and/or, call, tuple, list or arithmetic operation
- `replace PART by TEMPLATE`  any other change; `{PART}` in the template is what stands there in the statement

A PART is a path in Python's syntax tree, beginning at the statement: `test.values[1]`, `value.args[0]`; `.` is the
statement itself.
"""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

_NAME = r"[a-z0-9]+(?:-[a-z0-9]+)*"
_MARKER = re.compile(rf"#\s*safety: ({_NAME}(?:, {_NAME})*)$")
_LOOKS_LIKE = re.compile(r"#\s*safety\s*:", re.IGNORECASE)
_STEP = re.compile(r"([a-z_]+)((?:\[\d+\])*)")


class MarkerError(Exception):
    """The markers, or a mutation, are wrong; the message says where."""


@dataclass(frozen=True)
class MarkedStatement:
    """A statement that keeps a rule."""

    path: Path
    text: str  # the file's
    node: ast.AST


def find_marked(sources: Path) -> dict[str, MarkedStatement]:
    """The marked statements of all Python files below `sources` by the markers' names; each name stands once."""
    marked: dict[str, MarkedStatement] = {}
    for path in sorted(sources.rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        if not _LOOKS_LIKE.search(text):
            continue
        for name, node in _read_markers(text, path):
            if name in marked:
                raise MarkerError(f"two statements are marked '{name}': in {marked[name].path} and in {path}")
            marked[name] = MarkedStatement(path, text, node)
    return marked


def _read_markers(text: str, path: Path) -> list[tuple[str, ast.AST]]:
    found = []
    nodes = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.stmt | ast.ExceptHandler)]
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type != tokenize.COMMENT or not _LOOKS_LIKE.search(token.string):
            continue
        names, line = _MARKER.search(token.string), token.start[0]
        if names is None:
            raise MarkerError(f"{path}:{line}: a marker ends with its names, like `# safety: stop-latches`")
        alone = token.line.strip() == token.string.strip()
        node = _find_following(nodes, line) if alone else _find_around(nodes, line)
        if node is None:
            raise MarkerError(f"{path}:{line}: no statement is marked by this")
        found += [(name, node) for name in names[1].split(", ")]
    return found


def _find_following(nodes: list[ast.AST], line: int) -> ast.AST | None:
    return min((node for node in nodes if node.lineno > line), key=_locate, default=None)


def _find_around(nodes: list[ast.AST], line: int) -> ast.AST | None:
    around = [node for node in nodes if node.lineno <= line <= node.end_lineno]
    return max(around, key=lambda node: (node.lineno, -node.col_offset), default=None)


def _locate(node: ast.AST) -> tuple[int, int]:
    return node.lineno, node.col_offset


def break_code(marked: MarkedStatement, mutation: str) -> str:
    """The file's text with the marked statement broken; MarkerError if `mutation` does not fit or changes nothing."""
    try:
        node, words = _mutate(marked, mutation)
    except (AttributeError, IndexError, TypeError, KeyError) as cause:
        raise MarkerError(f"'{mutation}' does not fit {_quote(marked)}") from cause
    broken = _replace(marked.text, node, words)
    try:
        changed = ast.dump(ast.parse(broken)) != _dump(marked.text)
    except SyntaxError as cause:
        raise MarkerError(f"'{mutation}' makes no Python of {_quote(marked)}: {words}") from cause
    if not changed:
        raise MarkerError(f"'{mutation}' leaves {_quote(marked)} as it is")
    return broken


@cache
def _dump(text: str) -> str:
    return ast.dump(ast.parse(text))


def _mutate(marked: MarkedStatement, mutation: str) -> tuple[ast.AST, str]:
    """What is replaced, and by which text."""
    kind, _, rest = mutation.partition(" ")
    if whole := {"drop": "pass", "return": "return"}.get(mutation):
        return marked.node, whole
    if mutation in ("never", "always"):
        return _find_condition(marked.node), str(mutation == "always")
    if mutation == "uncaught":
        return marked.node.type, "()"
    if kind == "replace" and " by " in rest:
        part, _, template = rest.partition(" by ")
        words = re.sub(r"\{([^{}]+)\}", lambda match: _cut(marked.text, _walk(marked.node, match[1])), template)
        return _walk(marked.node, part), words
    if counted := re.fullmatch(r"(only|without) ([1-9])(?: of (.+))?", mutation):
        node = _walk(marked.node, counted[3]) if counted[3] else _find_operation(marked.node)
        return node, _choose(marked.text, node, int(counted[2]) - 1, counted[1] == "only")
    raise MarkerError(f"there is no mutation '{mutation}'")


def _walk(node: ast.AST, part: str) -> ast.AST:
    """The part of `node` that lies behind the path `part`."""
    for step in part.split(".") if part != "." else ():
        match = _STEP.fullmatch(step)
        if match is None:
            raise MarkerError(f"'{part}' is no path in a syntax tree")
        node = getattr(node, match[1])
        for index in re.findall(r"\d+", match[2]):
            node = node[int(index)]
    return node


def _find_condition(node: ast.AST) -> ast.expr:
    if isinstance(node, ast.If | ast.While | ast.Assert):
        return node.test
    return _find_first(node, ast.IfExp).test


def _find_operation(node: ast.AST) -> ast.expr:
    return _find_first(node, ast.BoolOp) or _find_first(node, ast.Call)


def _find_first(node: ast.AST, kind: type[ast.AST]) -> ast.AST | None:
    """The outermost expression of a kind in a statement, not in the statements that belong to it."""
    own = [child for child in ast.iter_child_nodes(node) if not isinstance(child, ast.stmt | ast.ExceptHandler)]
    return next((found for child in own for found in ast.walk(child) if isinstance(found, kind)), None)


def _choose(text: str, node: ast.AST, number: int, alone: bool) -> str:
    """The operation `node` with only its operand `number`, or with all others."""
    operands, join = _take_apart(text, node)
    chosen = _cut(text, operands[number])
    return chosen if alone else join([_cut(text, part) for part in operands if part is not operands[number]])


def _take_apart(text: str, node: ast.AST) -> tuple[list[ast.AST], Callable[[list[str]], str]]:
    if isinstance(node, ast.BoolOp):
        sign = " and " if isinstance(node.op, ast.And) else " or "
        return list(node.values), lambda parts: f"({sign.join(parts)})"
    if isinstance(node, ast.Call):
        return [*node.args, *node.keywords], lambda parts: f"{_cut(text, node.func)}({', '.join(parts)})"
    if isinstance(node, ast.Tuple | ast.List):
        left, right = "()" if isinstance(node, ast.Tuple) else "[]"
        return list(node.elts), lambda parts: f"{left}{''.join(f'{part}, ' for part in parts)}{right}"
    if isinstance(node, ast.BinOp):
        return [node.left, node.right], lambda parts: parts[0]
    raise TypeError(node)


def _cut(text: str, node: ast.AST) -> str:
    """The text of `node`: an expression in brackets, so that it means the same wherever it is put."""
    words = ast.get_source_segment(text, node)
    if words is None:
        raise TypeError(node)
    return f"({words})" if isinstance(node, ast.expr) and not isinstance(node, ast.Starred) else words


def _replace(text: str, node: ast.AST, words: str) -> str:
    lines = text.encode().splitlines(keepends=True)  # the syntax tree counts columns in bytes
    before = b"".join(lines[: node.lineno - 1]) + lines[node.lineno - 1][: node.col_offset]
    after = lines[node.end_lineno - 1][node.end_col_offset :] + b"".join(lines[node.end_lineno :])
    return (before + words.encode() + after).decode()


def _quote(marked: MarkedStatement) -> str:
    first = ast.get_source_segment(marked.text, marked.node) or ""
    return f"`{first.splitlines()[0]}` ({marked.path}:{marked.node.lineno})"
