"""What is felt: State in, wrench out. Worlds add.

Adding a world is one class with one method, and one line in `CATALOGUE`.
"""

from __future__ import annotations

from haptorb.errors import UnknownName
from haptorb.worlds.dome import Dome
from haptorb.worlds.nothing import Nothing
from haptorb.worlds.outlet import Outlet, PublishedOutlet
from haptorb.worlds.snap_fit import SnapFit
from haptorb.worlds.world import World

__all__ = ["CATALOGUE", "Dome", "Nothing", "Outlet", "PublishedOutlet", "SnapFit", "World", "named"]

#: name on the command line → world; contract tests run over all of them
CATALOGUE: dict[str, type[World]] = {
    "dome": Dome,
    "nothing": Nothing,
    "outlet": Outlet,
    "outlet-published": PublishedOutlet,
    "snap_fit": SnapFit,
}


def named(name: str) -> type[World]:
    """The world called `name`, or UnknownName with the nearest."""
    if name not in CATALOGUE:
        raise UnknownName("world", name, CATALOGUE)
    return CATALOGUE[name]
