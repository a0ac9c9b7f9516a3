"""One reference page per room of the package, written from what its modules declare public.

With `-D rooms_in_brief=1` a page has only the room itself and the modules behind what `import haptorb` offers: the
other six hundred take two thirds of the build, for which not every test run needs to wait.
"""

from __future__ import annotations

import inspect
import pkgutil
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

from sphinx.application import Sphinx

import haptorb

PACKAGES = ("haptorb_design", "haptorb_study")  #: beside haptorb
_FOUND = sorted(found.name for found in pkgutil.iter_modules(haptorb.__path__))
ROOMS = [*(name for name in _FOUND if name != "version" and not name.startswith("_")), *PACKAGES]


def modules(room: str) -> list[ModuleType]:
    """A room's module and, if it is a package, all modules in it."""
    top = import_module(room if room in PACKAGES else f"haptorb.{room}")
    below = pkgutil.walk_packages(getattr(top, "__path__", []), top.__name__ + ".")
    names = [found.name for found in below if not any(part.startswith("_") for part in found.name.split("."))]
    return [top, *(import_module(name) for name in names)]


def shorten(shown: list[ModuleType]) -> list[ModuleType]:
    """The first of a room's modules, and those to which the page of `import haptorb` points."""
    offered = {getattr(getattr(haptorb, name), "__module__", "") for name in haptorb.__all__}
    return [module for number, module in enumerate(shown) if number == 0 or module.__name__ in offered]


def package() -> list[str]:
    """The page of what `import haptorb` offers: each name, and the module that describes it."""
    lines = [
        ".. _package:",
        "",
        "haptorb",
        "=======",
        "",
        "What ``import haptorb`` offers, loaded when first used.",
        "",
    ]
    for public in haptorb.__all__:
        thing = getattr(haptorb, public)
        if inspect.ismodule(thing):
            lines += [f"``haptorb.{public}``", f"   The package :ref:`room-{public}`.", ""]
            continue
        first = (inspect.getdoc(thing) or "").splitlines()[0].replace("`", "``").replace("*", "\\*").replace("|", "\\|")
        lines += [f":any:`haptorb.{public} <{thing.__module__}.{thing.__qualname__}>`", f"   {first}", ""]
    return lines


def section(module: ModuleType) -> list[str]:
    """The part of a page that is about one module: what it says of itself, then its own public names."""
    name = module.__name__
    lines = [name, "-" * len(name), "", f".. automodule:: {name}", "   :no-members:", ""]
    for public in getattr(module, "__all__", ()):
        thing = getattr(module, public)
        if inspect.ismodule(thing) or getattr(thing, "__module__", name) != name:
            continue  # defined elsewhere, described there
        kind = "class" if inspect.isclass(thing) else "function" if callable(thing) else "data"
        lines += [f".. auto{kind}:: {name}.{public}"]
        if kind == "class":
            lines += ["   :members:"]
            if thing.__bases__ != (object,):
                lines += ["   :show-inheritance:"]
        lines += [""]
    return lines


def _write(app: Sphinx) -> None:
    folder = Path(app.srcdir) / "reference" / "generated"
    folder.mkdir(parents=True, exist_ok=True)
    pages = {"package": package()}
    for room in ROOMS:
        pages[room] = [f".. _room-{room}:", "", room, "=" * len(room), ""]
        shown = modules(room)
        for module in shorten(shown) if app.config.rooms_in_brief else shown:
            pages[room] += section(module)
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
