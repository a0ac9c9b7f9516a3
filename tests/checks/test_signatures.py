"""Signatures and state that a newcomer can read: few arguments, and fields that have names instead of numbers."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

pytestmark = pytest.mark.background

SOURCES = Path(__file__).resolve().parents[2] / "src"
KERNEL = 10  #: arguments of a kernel
KERNELS = {"kernel", "tick_kernel", "vector_kernel"}
POSITIONAL = 8  #: positional arguments of any other function
COMMANDS = "haptorb/apps/cli"  #: where a command's options are its arguments

Function = ast.FunctionDef | ast.AsyncFunctionDef


@cache
def _functions() -> list[tuple[str, Function]]:
    return [
        (str(path.relative_to(SOURCES)), node)
        for path in sorted(SOURCES.rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, Function)
    ]


def _is_kernel(function: Function) -> bool:
    return any(isinstance(one, ast.Name) and one.id in KERNELS for one in function.decorator_list)


def _is_command(path: str, function: Function) -> bool:
    """Whether the arguments are the options of a command: each is told how to be read from the command line, on the
    spot or by a type that several commands share."""
    kinds = [ast.unparse(one.annotation) for one in function.args.args if one.annotation]
    options = [one for one in kinds if "Annotated[" in one or one.endswith(("Option", "Argument"))]
    return path.startswith(COMMANDS) and len(options) > len(function.args.args) / 2


def _positional(function: Function) -> int:
    names = [one.arg for one in (*function.args.posonlyargs, *function.args.args)]
    return len(names) - (names[:1] in (["self"], ["cls"]))


def test_no_kernel_takes_many_arguments() -> None:
    counts = {f"{path}: {one.name}": _positional(one) for path, one in _functions() if _is_kernel(one)}
    assert {name: count for name, count in counts.items() if count > KERNEL} == {}


def test_no_other_function_takes_many_positional_arguments() -> None:
    counts = {
        f"{path}: {one.name}": _positional(one)
        for path, one in _functions()
        if not (_is_kernel(one) or _is_command(path, one))
    }
    assert {name: count for name, count in counts.items() if count > POSITIONAL} == {}


def _indices(function: Function) -> Iterator[ast.expr]:
    for node in ast.walk(function):
        if isinstance(node, ast.Subscript):
            yield from node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]


def test_no_kernel_keeps_what_it_remembers_by_constants() -> None:
    """`state[SPEED]` is a field that wants a name: `state.speed` of a structured array."""
    found = {
        f"{path}: {one.name}: [{ast.unparse(index)}]"
        for path, one in _functions()
        if _is_kernel(one)
        for index in _indices(one)
        if isinstance(index, ast.Name) and index.id.isupper() and len(index.id) > 1
    }
    assert found == set()
