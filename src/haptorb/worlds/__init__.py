"""Worlds: virtual objects and forces; a world maps a State to a wrench. Worlds can be added.

To add a world, write one class with one method, and one line in `CATALOGUE`.
"""

from __future__ import annotations

from haptorb.errors import UnknownName
from haptorb.worlds.ball import RollingBall
from haptorb.worlds.base import ContactWorld, Shape, Sum, World, parameter
from haptorb.worlds.basic import Detents, Magnet, Nothing, Texture, Vibration, Wall
from haptorb.worlds.button import Button
from haptorb.worlds.client_force import Remote
from haptorb.worlds.dome import Compass, CompassDome, Dome, domes_apart
from haptorb.worlds.dynamic import DynamicSum, DynamicWorld, MemoryField, make_memory
from haptorb.worlds.fluid import Fluid, StirredFluid
from haptorb.worlds.friction import Friction, StickSlip
from haptorb.worlds.guidance import Guidance
from haptorb.worlds.moving import ChangingTerrain, Orbit, Summits, Varying, Wander
from haptorb.worlds.path import GuidancePath, load_path, make_path
from haptorb.worlds.path_guidance import PathGuidance
from haptorb.worlds.scene import Scene
from haptorb.worlds.snap_fit import Outlet, PublishedOutlet, SnapFit
from haptorb.worlds.terrain import Terrain

__all__ = [
    "CATALOGUE",
    "Button",
    "ChangingTerrain",
    "Compass",
    "CompassDome",
    "ContactWorld",
    "Detents",
    "Dome",
    "DynamicSum",
    "DynamicWorld",
    "Fluid",
    "Friction",
    "Guidance",
    "GuidancePath",
    "Magnet",
    "MemoryField",
    "Nothing",
    "Orbit",
    "Outlet",
    "PathGuidance",
    "PublishedOutlet",
    "Remote",
    "RollingBall",
    "Scene",
    "Shape",
    "SnapFit",
    "StickSlip",
    "StirredFluid",
    "Sum",
    "Summits",
    "Terrain",
    "Texture",
    "Varying",
    "Vibration",
    "Wall",
    "Wander",
    "World",
    "domes_apart",
    "find_world",
    "load_path",
    "make_memory",
    "make_path",
    "parameter",
]

#: World classes by their names on the command line.
CATALOGUE: dict[str, type[World]] = {
    "dome": Dome,
    "nothing": Nothing,
    "detents": Detents,
    "fluid": Fluid,
    "guidance": Guidance,
    "path_guidance": PathGuidance,
    "magnet": Magnet,
    "stick_slip": StickSlip,
    "terrain": Terrain,
    "texture": Texture,
    "vibration": Vibration,
    "wall": Wall,
    "orbit": Orbit,
    "wander": Wander,
    "summits": Summits,
    "changing_terrain": ChangingTerrain,
    "compass": Compass,
    "compass_dome": CompassDome,
    "outlet": Outlet,
    "outlet-published": PublishedOutlet,
    "snap_fit": SnapFit,
    "ball": RollingBall,
    "button": Button,
    "friction": Friction,
    "stirred_fluid": StirredFluid,
    "remote": Remote,
}


def find_world(name: str) -> type[World]:
    """Find a world of the catalogue by its name.

    Parameters
    ----------
    name : str
        Name on the command line, such as "dome"; `haptorb worlds` lists them.

    Returns
    -------
    type of World
        Class of the world; its parameters have defaults.

    Raises
    ------
    UnknownName
        If there is no such world; the message names the most similar one.

    Examples
    --------
    >>> find_world("dome").__name__
    'Dome'
    """
    if name not in CATALOGUE:
        raise UnknownName("world", name, CATALOGUE)
    return CATALOGUE[name]
