"""Docstrings of public names: shapes of arrays, units of numbers, and exceptions.

The rules, for functions, methods and constructors that a module declares in `__all__`:

shape    a parameter or result that is an array has its shape in the docstring: "(n, 3)", "(...)", "(m,)", "same shape"
unit     a docstring with shapes names a unit in brackets: [m], [N·m/A], [T], [1]; or says that numbers have none
raises   one whose own body raises an error of haptorb names that error, or says "Raises"
source   a module of physics that has an equation in it names where it is from: a paper's key or author, a textbook, or
         the law by name
"""

from __future__ import annotations

import ast
import inspect
import pkgutil
import re
import textwrap
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import haptorb
from haptorb import errors

ROOMS = (
    *("magnetics", "thermal", "beams", "devices", "estimation", "control", "analysis", "worlds", "simulation"),
    *("recording", "runtime", "replay"),
)
_SIZE = r"(?:[\w′']+|\.\.\.|\d+)"
SHAPE = re.compile(
    rf"\(({_SIZE}([ ,·+*]+({_SIZE}|\w+ [+·] \w+))*,?)?\)|same shape|shape of|their shape|points' shape|square|matrix"
)
UNIT = re.compile(
    r"\[[^\]\n]*\]|\bdegrees?\b|\bunit vectors?\b|\brotations?\b|\bquaternions?\b|\bsigns?\b|\bcosines?\b|"
    r"without dimension|\bshares?\b|\bnormalised|\bcoefficients?\b|\bfactor|\bstandardised|\bratio|\bduties\b|±1"
)
ERRORS = {*errors.__all__, "ValueError"}


@cache
def modules() -> list[ModuleType]:
    """Every module of the rooms whose names are asked."""
    names = [found.name for found in pkgutil.walk_packages(haptorb.__path__, "haptorb.")]
    wanted = tuple(f"haptorb.{room}" for room in ROOMS)
    return [
        import_module(name)
        for name in names
        if name.startswith(wanted) and not any(part.startswith("_") for part in name.split("."))
    ]


@cache
def callables(module: ModuleType) -> tuple[tuple[str, Any, str], ...]:
    """What `find_callables` finds."""
    return tuple(find_callables(module))


def find_callables(module: ModuleType) -> Iterator[tuple[str, Any, str]]:
    """(name, function, docstring that must tell) of what a module declares: functions, methods, constructors."""
    for name in getattr(module, "__all__", ()):
        thing = getattr(module, name)
        if getattr(thing, "__module__", None) != module.__name__:
            continue
        if inspect.isfunction(thing):
            yield name, thing, inspect.getdoc(thing) or ""
        elif inspect.isclass(thing):
            own = inspect.getdoc(thing) or ""
            for key, member in vars(thing).items():
                function = member.fget if isinstance(member, property) else getattr(member, "__func__", member)
                if not inspect.isfunction(function) or (key.startswith("_") and key != "__init__"):
                    continue
                if getattr(function, "__qualname__", "").startswith(thing.__name__):
                    # what a class says of its fields, in its docstring or beside them, holds for its methods too
                    told = "\n".join([inspect.getdoc(getattr(thing, key)) or "", own, *_remarks(thing)])
                    yield f"{name}.{key}", function, told


@cache
def _remarks(thing: type) -> tuple[str, ...]:
    """The comments beside a class's fields: #: (3,) ... [m]."""
    try:
        return tuple(re.findall(r"#: (.*)", inspect.getsource(thing)))
    except (OSError, TypeError):
        return ()


def arrays(function: Any) -> tuple[bool, bool]:
    """Whether parameters, and whether the result, are arrays."""
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):
        return False, False
    kinds = [str(parameter.annotation) for name, parameter in signature.parameters.items() if name != "self"]
    return any(re.search(r"\bArray(Like)?\b", kind) for kind in kinds), bool(
        re.search(r"\bArray\b", str(signature.return_annotation))
    )


def errors_raised_by(function: Any) -> set[str]:
    """Errors of haptorb that the function's own body raises."""
    try:
        tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
    except (OSError, TypeError, SyntaxError):
        return set()
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call) and isinstance(node.exc.func, ast.Name):
            found.add(node.exc.func.id)
    return found & ERRORS


def list_mute(module: ModuleType) -> Iterator[str]:
    """Functions with arrays whose docstring lacks a shape or a unit."""
    for name, function, told in callables(module):
        takes, gives = arrays(function)
        if not (takes or gives):
            continue
        if not SHAPE.search(told):
            yield f"{module.__name__}: {name}: no shape"
        elif not UNIT.search(told):
            yield f"{module.__name__}: {name}: no unit"


def test_arrays_have_shapes_and_units() -> None:
    assert len(modules()) > 80
    assert [fault for module in modules() for fault in list_mute(module)] == []


def list_untold(module: ModuleType) -> Iterator[str]:
    """Functions that raise an error of haptorb and do not say so."""
    for name, function, told in callables(module):
        errors_ = errors_raised_by(function)
        said = told + "\n" + (module.__doc__ or "")
        if errors_ and not (any(error in said for error in errors_) or re.search(r"[Rr]aise|[Rr]efuse", told)):
            yield f"{module.__name__}: {name}: raises {', '.join(sorted(errors_))}"


def test_what_is_raised_is_told() -> None:
    assert [fault for module in modules() for fault in list_untold(module)] == []


def test_physics_names_its_source() -> None:
    named = (
        r"\b(19|20)\d\d\b|[Ee]qs?\.|Gauss|Maxwell|Biot|Ampère|Coulomb|Timoshenko|Legendre|Euler|Ohm|erratum|Bulirsch"
    )
    mute = []
    for module in modules():
        if module.__name__.startswith(("haptorb.magnetics.", "haptorb.thermal", "haptorb.beams")):
            said = (module.__doc__ or "") + "".join(told for _, _, told in callables(module))
            if re.search(r"[∫Σ]", said) and not re.search(named, said):
                mute.append(module.__name__)
    assert mute == [], "where are their equations from?"


def test_no_two_classes_have_the_same_name(root: Path) -> None:
    """A search for a name finds one class, whichever of our packages it is in."""
    places: dict[str, list[str]] = {}
    for path in (path for folder in ("src", "papers") for path in sorted((root / folder).rglob("*.py"))):
        for name in re.findall(r"^class ([A-Za-z]\w*)", path.read_text(encoding="utf-8"), re.MULTILINE):
            places.setdefault(name, []).append(str(path.relative_to(root)))
    assert len(places) > 300
    assert {name: found for name, found in places.items() if len(found) > 1} == {}
