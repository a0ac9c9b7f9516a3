"""Virtual objects and forces: a world maps a State to a wrench. Worlds add.

To add a world, write one class with one method, and one line in `CATALOGUE`.
"""

from __future__ import annotations

from haptorb.errors import UnknownName
from haptorb.worlds.basic.detents import Detents
from haptorb.worlds.basic.fluid import Fluid
from haptorb.worlds.basic.guidance import Guidance
from haptorb.worlds.basic.magnet import Magnet
from haptorb.worlds.basic.nothing import Nothing
from haptorb.worlds.basic.stick_slip import StickSlip
from haptorb.worlds.basic.texture import Texture
from haptorb.worlds.basic.vibration import Vibration
from haptorb.worlds.basic.wall import Wall
from haptorb.worlds.contact_world import ContactWorld
from haptorb.worlds.dynamic.ball import RollingBall
from haptorb.worlds.dynamic.button import Button
from haptorb.worlds.dynamic.friction import Friction
from haptorb.worlds.dynamic.remote import Remote
from haptorb.worlds.dynamic.stirred_fluid import StirredFluid
from haptorb.worlds.dynamic_world import DynamicSum, DynamicWorld
from haptorb.worlds.maps.changing import ChangingTerrain, Summits
from haptorb.worlds.maps.compass import Compass, CompassDome
from haptorb.worlds.maps.dome import Dome
from haptorb.worlds.maps.domes import domes_apart
from haptorb.worlds.maps.terrain import Terrain
from haptorb.worlds.memory import MemoryField, make_memory
from haptorb.worlds.moving import Orbit, Varying, Wander
from haptorb.worlds.path_guidance.guidance_path import GuidancePath, make_path
from haptorb.worlds.path_guidance.path_file import load_path
from haptorb.worlds.path_guidance.path_guidance import PathGuidance
from haptorb.worlds.scene.scene import Scene
from haptorb.worlds.shape import Shape
from haptorb.worlds.snap_fit.outlet import Outlet
from haptorb.worlds.snap_fit.published_outlet import PublishedOutlet
from haptorb.worlds.snap_fit.snap_fit import SnapFit
from haptorb.worlds.world import Sum, World

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
]

#: name on the command line → world; contract tests run over all of them
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
    """The world called `name`. Raises UnknownName with the most similar name."""
    if name not in CATALOGUE:
        raise UnknownName("world", name, CATALOGUE)
    return CATALOGUE[name]
