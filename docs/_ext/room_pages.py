"""The pages of the public API, and one page per internal package, written from what modules declare public.

With `-D rooms_in_brief=1` an internal page has only the first module of its package, and there is no index to search:
the other hundreds of modules take two thirds of the build, for which not every test run needs to wait.
"""

from __future__ import annotations

import ast
import inspect
import pkgutil
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

from sphinx.application import Sphinx
from sphinx.pycode import ModuleAnalyzer

import haptorb

#: the packages with public names
PUBLIC = ("haptorb", "haptorb.worlds", "haptorb.devices", "haptorb.kinds", "haptorb.magnetics", "haptorb.testing",
          "haptorb_study", "haptorb_design")  # fmt: skip
PACKAGES = ("haptorb_design", "haptorb_study")  #: beside haptorb
_FOUND = sorted(found.name for found in pkgutil.iter_modules(haptorb.__path__))
ROOMS = [*(name for name in _FOUND if name != "version" and not name.startswith("_")), *PACKAGES]

_INTRODUCTION = """
.. _public-api:

Public API
==========

These eight packages are the public API of haptorb: what the documentation uses is imported from them. A name's module
is loaded when the name is first used.

All other modules are internal and may change without notice.
``haptorb_study`` and ``haptorb_design`` need the extras ``haptorb[study]`` and ``haptorb[design]``.
"""

_INTERNAL = """
Internal modules
================

For those who change haptorb itself. Programs import from the :ref:`public-api` only: everything here may change without
notice.
"""


def modules(room: str) -> list[ModuleType]:
    """A room's module and, if it is a package, all modules in it."""
    top = import_module(room if room in PACKAGES else f"haptorb.{room}")
    below = pkgutil.walk_packages(getattr(top, "__path__", []), top.__name__ + ".")
    names = [found.name for found in below if not any(part.startswith("_") for part in found.name.split("."))]
    return [top, *(import_module(name) for name in names)]


def sources(package: str) -> dict[str, tuple[str, str]]:
    """Public name of `package` → (module that defines it, its name there)."""
    module = import_module(package)
    found: dict[str, tuple[str, str]] = {}
    for node in ast.walk(ast.parse(inspect.getsource(module))):
        if isinstance(node, ast.ImportFrom) and node.module:
            found |= {alias.asname or alias.name: (node.module, alias.name) for alias in node.names}
    return {name: found.get(name, (package, name)) for name in module.__all__}


#: place of definition → public name
_PUBLIC_NAMES = {place: f"{package}.{name}" for package in PUBLIC for name, place in sources(package).items()}

_PUBLIC_CLASSES = [getattr(import_module(module), name) for module, name in _PUBLIC_NAMES]


def _about_data(module: str, name: str) -> str:
    """The comment beside a constant."""
    return " ".join(ModuleAnalyzer.for_module(module).find_attr_docs()[("", name)]).strip()


def _first_line(thing: object, place: tuple[str, str]) -> str:
    """What the overview says of a name."""
    documented = inspect.isclass(thing) or inspect.isroutine(thing)
    text = (inspect.getdoc(thing) or "").splitlines()[0] if documented else _about_data(*place)
    return text.replace("`", "``").replace("*", "\\*").replace("|", "\\|")


def overview() -> list[str]:
    """The page that lists all public names with one line each."""
    lines = [*_INTRODUCTION.splitlines(), ""]
    for package in PUBLIC:
        lines += [package, "-" * len(package), "", f"In full: :doc:`{_page(package)}`.", ""]
        for name, place in sources(package).items():
            first = _first_line(getattr(import_module(package), name), place)
            lines += [f":any:`{name} <{package}.{name}>`", f"   {first}", ""]
    lines += [".. toctree::", "   :hidden:", "", *(f"   {_page(package)}" for package in PUBLIC), ""]
    return lines


def _page(package: str) -> str:
    return f"api-{package.replace('.', '-')}"


def public_page(package: str) -> list[str]:
    """The page of one public package: each of its names in full."""
    module = import_module(package)
    lines = [package, "=" * len(package), "", f".. automodule:: {package}", "   :no-members:", ""]
    for name, place in sources(package).items():
        thing = getattr(module, name)
        if inspect.isclass(thing) or inspect.isroutine(thing):
            lines += _describe(f"{package}.{name}", thing, public=True)
        else:
            lines += [f".. py:data:: {name}", f"   :module: {package}", "", f"   {_first_line(thing, place)}", ""]
    return lines


def _is_own(base: type) -> bool:
    return base.__module__.startswith("haptorb") and base.__name__ != "Presentable"


def _describe(name: str, thing: object, *, public: bool = False) -> list[str]:
    """The directive that describes a class, function or constant."""
    kind = "class" if inspect.isclass(thing) else "function" if callable(thing) else "data"
    lines = [f".. auto{kind}:: {name}"]
    if inspect.isclass(thing):
        fields = getattr(thing, "_fields", ()) if issubclass(thing, tuple) else ()  # of a named tuple
        lines += ["   :members:", f"   :exclude-members: {', '.join(fields) or '__none__'}"]
        if public:  # methods of internal bases are methods of this class; those of others are described there
            others = {base.__name__ for base in thing.__mro__[1:] if base in _PUBLIC_CLASSES or not _is_own(base)}
            lines += [f"   :inherited-members: {', '.join(sorted(others))}"]
        if thing.__bases__ != (object,):
            lines += ["   :show-inheritance:"]
    return [*lines, ""]


def internal() -> list[str]:
    """The page that lists the pages of internal packages."""
    return [*_INTERNAL.splitlines(), "", ".. toctree::", "   :maxdepth: 1", "", *(f"   {room}" for room in ROOMS), ""]


def section(module: ModuleType) -> list[str]:
    """The part of a page that is about one internal module: what it says of itself, then the names it defines."""
    name = module.__name__
    lines = [name, "-" * len(name), ""]
    if name in PUBLIC:
        return [*lines, f"Its public names: :doc:`{_page(name)}`.", ""]
    lines += [f".. automodule:: {name}", "   :no-members:", ""]
    for own in getattr(module, "__all__", ()):
        thing = getattr(module, own)
        if inspect.ismodule(thing) or getattr(thing, "__module__", name) != name:
            continue  # defined elsewhere, described there
        public = _PUBLIC_NAMES.get((name, own))
        if public is None:
            lines += _describe(f"{name}.{own}", thing)
        else:
            lines += [f"``{own}``", f"   public as :any:`{public}`", ""]
    return lines


def _write(app: Sphinx) -> None:
    if app.config.rooms_in_brief:
        app.builder.search = False
    folder = Path(app.srcdir) / "reference" / "generated"
    folder.mkdir(parents=True, exist_ok=True)
    pages = {"api": overview(), "internal": internal()} | {_page(package): public_page(package) for package in PUBLIC}
    for room in ROOMS:
        pages[room] = [f".. _room-{room}:", "", room, "=" * len(room), ""]
        shown = modules(room)
        for module in shown[:1] if app.config.rooms_in_brief else shown:
            pages[room] += section(module)
    for old in set(folder.glob("*.rst")) - {folder / f"{name}.rst" for name in pages}:
        old.unlink()
    for name, lines in pages.items():
        text = "\n".join(lines)
        page = folder / f"{name}.rst"
        if not page.exists() or page.read_text() != text:
            page.write_text(text)


def setup(app: Sphinx) -> dict[str, Any]:
    """Write the pages before Sphinx looks for them."""
    app.add_config_value("rooms_in_brief", False, "env", types=(bool,))
    app.connect("builder-inited", _write)
    return {"parallel_read_safe": True}
