"""Changes one factor or sign in a source file, located in its syntax tree by function and assigned name.

No source is quoted, so nothing has to be kept in step with its wording: a mutation names a function (dotted inside a
class; empty for the module itself) and a target in it, which is a name, subscript or attribute that is assigned, a
keyword of a call, or `return`.
"""

from __future__ import annotations

import ast
import re
from dataclasses import dataclass
from pathlib import Path

__all__ = ["Mutation", "MutationError", "change_code", "read_source"]

_STEP = re.compile(r"([a-z]+)(?:\[([^\]]+)\])?")


class MutationError(Exception):
    """A mutation fits nothing in its file; the message says which."""


@dataclass(frozen=True)
class Mutation:
    """What `target` becomes in `function` of `file` is multiplied by `factor`.

    file       below src/haptorb
    function   dotted name; empty for the module itself
    target     as above; `NAME#2` is the third place that assigns NAME; `NAME@args[0]` the first argument of the call
               that it is assigned, `NAME@elts[1]` the second part of the tuple, `NAME@keywords[x].value` its argument
               x, `NAME@values[a b]` the value of the key "a b" of the dict
    factor     [1]: −1 turns the sign, 0 leaves a term out; None leaves the part out of its product
    parts      reproductions whose rows are computed: "bai2012 appendix B"
    """

    file: str
    function: str
    target: str
    factor: float | None
    parts: tuple[str, ...]

    @property
    def name(self) -> str:
        """For people and for the record: file, place and change."""
        place = f"{self.function}: {self.target}" if self.function else self.target
        return f"{self.file}, {place} " + ("left out" if self.factor is None else f"× {self.factor:g}")


def change_code(text: str, mutation: Mutation) -> str:
    """The file's `text` with the mutation made.

    >>> change_code("def f(x):\\n    y = x + 1\\n    return y", Mutation("a.py", "f", "y", -1, ()))
    'def f(x):\\n    y = -1 * (x + 1)\\n    return y'
    """
    tree = ast.parse(text)
    scope = _find_function(tree, mutation)
    target, _, part = mutation.target.partition("@")
    target, _, count = target.partition("#")
    holders = _find_holders(scope, target)
    if len(holders) <= int(count or 0):
        raise MutationError(f"{mutation.name}: nothing assigns this there")
    holder: ast.AST = holders[int(count or 0)]
    field, index = "value", None
    try:
        for name, place in _STEP.findall(part):
            holder, field = _follow(holder, field, index), name
            index = _find_index(holder, field, place) if place else None
        scaled: ast.expr = ast.BinOp(ast.Constant(mutation.factor), ast.Mult(), _follow(holder, field, index))
    except (AttributeError, IndexError) as cause:
        raise MutationError(f"{mutation.name}: what is assigned there has no such part") from cause
    if mutation.factor is None:
        scaled = ast.Constant(1.0)
    if index is None:
        setattr(holder, field, scaled)
    else:
        getattr(holder, field)[index] = scaled
    return ast.unparse(ast.fix_missing_locations(tree))


def read_source(package: Path, mutation: Mutation) -> str:
    """The text of the mutation's file; MutationError if there is none."""
    path = package / mutation.file
    if not path.is_file():
        raise MutationError(f"{mutation.name}: there is no file {path}")
    return path.read_text(encoding="utf-8")


def _find_function(tree: ast.Module, mutation: Mutation) -> ast.AST:
    scope: ast.AST = tree
    for name in mutation.function.split(".") if mutation.function else ():
        kinds = ast.FunctionDef | ast.ClassDef
        inner = (node for node in ast.walk(scope) if isinstance(node, kinds) and node.name == name)
        found = next(inner, None)
        if found is None:
            raise MutationError(f"{mutation.name}: there is no such function")
        scope = found
    return scope


def _find_holders(scope: ast.AST, target: str) -> list[ast.Assign | ast.AugAssign | ast.keyword | ast.Return]:
    """The statements and keywords of `scope` that give `target` a value, in the order of the file."""
    nodes = scope.body if isinstance(scope, ast.Module) else ast.walk(scope)
    found = [node for node in nodes if getattr(node, "value", None) is not None and target in _list_targets(node)]
    return sorted(found, key=lambda node: (node.value.lineno, node.value.col_offset))


def _list_targets(node: ast.AST) -> list[str]:
    """What `node` gives a value to, as it is named here."""
    match node:
        case ast.Return():
            return ["return"]
        case ast.keyword():
            return [str(node.arg)]
        case ast.Assign():
            return [_describe(one) for one in node.targets]
        case ast.AugAssign() | ast.AnnAssign():
            return [_describe(node.target)]
    return []


def _describe(node: ast.expr) -> str:
    """`out[i, j]`, `self.x`; several names with commas."""
    return ast.unparse(node).strip("()")


def _find_index(node: ast.AST, field: str, place: str) -> int:
    """The position that `place` names: a number, a keyword of a call, a key of a dict. Raises IndexError for others."""
    if place.isdecimal():
        return int(place)
    names = {
        "keywords": [one.arg for one in getattr(node, "keywords", ())],
        "values": [getattr(one, "value", None) for one in getattr(node, "keys", ())],
    }.get(field, [])
    if place not in names:
        raise IndexError(place)
    return names.index(place)


def _follow(node: ast.AST, field: str, index: int | None) -> ast.expr:
    found = getattr(node, field)
    return found if index is None else found[index]
