"""Lazy public names of a package: a name's module is imported when the name is first used.

`haptorb --help` must not wait for a compiler, and `import haptorb` must not wait for Matplotlib. A package lists its
public names three times: in `__all__`, for `from package import *` and type checkers; under `TYPE_CHECKING`, for type
checkers and editors; and here, for Python. `tests/checks/test_public_api.py` compares the three.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module

__all__ = ["lazy_names"]


def lazy_names(package: str, sources: Mapping[str, str]) -> tuple[Callable[[str], object], Callable[[], list[str]]]:
    """Return the functions `__getattr__` and `__dir__` of `package`, whose public names come from other modules.

    sources: module → the names that it defines, separated by spaces; "name>public" gives `name` another public name.

    >>> get, listing = lazy_names("rotations", {"haptorb.rotations": "rotation_from_euler>from_euler"})
    >>> get("from_euler").__name__, listing()
    ('rotation_from_euler', ['from_euler'])
    >>> get("from_eular")
    Traceback (most recent call last):
    AttributeError: module 'rotations' has no attribute 'from_eular'
    """
    homes: dict[str, tuple[str, str]] = {}
    for module, names in sources.items():
        for one in names.split():
            name, _, public = one.partition(">")
            homes[public or name] = (module, name)

    def get(name: str) -> object:
        if name not in homes:
            raise AttributeError(f"module '{package}' has no attribute '{name}'")
        module, own = homes[name]
        return getattr(import_module(module), own)

    return get, lambda: sorted(homes)
