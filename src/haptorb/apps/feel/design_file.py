"""A file of candidate designs P: hook sizes, angles, material; checked as a whole, every mistake named.

title = "Cover clip"
world = "snap_fit"               # or "outlet", or a world of your own: "groove.py:Groove", with its parameters
beam = "timoshenko"              # or "paper"
force_scale = 1.0                # all torques of the handle times this

[common]                         # what the designs share; a design may say otherwise
material = "ABS"
friction = 0.3
width = "6 mm"

[design.slender]
base_length = "15 mm"
peak = "18.5 mm"
thickness = "1.5 mm"
height = "1.5 mm"
insertion = "30 deg"
retention = "45 deg"
top = "flat"                     # a flat top joins the end of the rear face to the peak
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from annotated_types import Gt
from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from haptorb.devices.schema import key as m
from haptorb.devices.schema import quantity as q
from haptorb.errors import quote
from haptorb.physics.beams import Model
from haptorb.worlds import Outlet, SnapFit
from haptorb.worlds.own.world_file import is_world_file
from haptorb.worlds.parameter import parameters

__all__ = ["ONLY", "DesignFile", "DesignTable"]

Positive = Gt(0)
DesignName = Annotated[str, Field(pattern=r"^[^\x00-\x1f\x7f-\x9f/]+$", max_length=64)]  #: also of files of traces
Length = Annotated[q.Length, Positive]
Angle = Annotated[q.Angle, Positive]
Modulus = Annotated[q.Modulus, Positive]


def _world_range(key: str) -> m.Form:
    """What the worlds allow for `key`: in mm, GPa or degrees."""
    ranges = {}
    for name, world in (("snap_fit", SnapFit), ("outlet", Outlet)):
        known = parameters(world).get(key) or parameters(world).get(f"{key}_deg")
        if known is not None:
            scale, unit = {"m": (1e3, " mm"), "Pa": (1e-9, " GPa"), "°": (1.0, " deg")}.get(known.unit, (1.0, ""))
            ranges[name] = f"{scale * known.low:g} to {scale * known.high:g}{unit}"
    if len(set(ranges.values())) == 1:
        return m.Form(next(iter(ranges.values())))
    return m.Form("; ".join(f"{name}: {text}" for name, text in ranges.items()))


def _world_default(key: str) -> m.Without:
    """What the world of the file takes where a design has no `key`, a length."""
    known = next(found for world in (SnapFit, Outlet) if (found := parameters(world).get(key)))
    return m.Without(f"{1e3 * float(known.default):g} mm" if isinstance(known.default, int | float) else "")


class DesignTable(BaseModel):
    """One [design.NAME], with [common] filled in."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    title: Annotated[str, m.Meaning("title of the design"), m.Form("text"), m.Without("the name of its table")] = ""
    material: Annotated[
        str,
        m.Meaning("material of the hook"),
        m.Form("a known material, or any name with youngs_modulus and poisson_ratio"),
    ]
    metal: Annotated[
        Annotated[bool, Field(strict=True)] | None,
        m.Meaning("whether the material is a metal"),
        m.Without("that of the known material, else false"),
    ] = None
    youngs_modulus: Annotated[
        Modulus | None,
        m.Meaning("modulus of elasticity"),
        _world_range("youngs_modulus"),
        m.Without("that of the known material"),
    ] = None
    poisson_ratio: Annotated[
        Annotated[float, Field(ge=0, lt=0.5, strict=True)] | None,
        m.Meaning("Poisson's ratio"),
        _world_range("poisson_ratio"),
        m.Without("that of the known material"),
    ] = None
    yield_strength: Annotated[
        Modulus | None,
        m.Meaning("yield strength of the material, for the yield margin in the report"),
        m.Without("that of the known material"),
    ] = None
    friction: Annotated[
        float, Field(ge=0, le=1, strict=True), m.Meaning("coefficient of friction between hook and edge")
    ]
    base_length: Annotated[
        Length, m.Meaning("distance from the root to the foot of the rear face, ℓ_b"), _world_range("base_length")
    ]
    peak: Annotated[
        Length,
        m.Meaning("distance from the root to the start of the front face, the hook's peak ℓ_m"),
        _world_range("peak"),
    ]
    thickness: Annotated[Length, m.Meaning("thickness of the beam, h_0"), _world_range("thickness")]
    height: Annotated[Length, m.Meaning("height of the hook over the beam, h_b"), _world_range("height")]
    width: Annotated[Length, m.Meaning("width of the beam, w"), _world_range("width")]
    insertion: Annotated[
        Angle, m.Meaning("angle of the front face, which slides in; no effect in an outlet"), _world_range("insertion")
    ] = Field(default="30 deg", validate_default=True)
    retention: Annotated[
        Angle, m.Meaning("angle of the rear face, which sets the holding force"), _world_range("retention")
    ]
    top: Annotated[
        Literal["sharp", "flat"], m.Meaning("whether a flat top joins the end of the rear face to the peak")
    ] = "sharp"
    half_width: Annotated[
        Length | None,
        m.Meaning("distance from the part's centre to the edge that touches a hook; snap_fit only"),
        _world_range("half_width"),
        _world_default("half_width"),
    ] = None
    clearance: Annotated[
        q.Length | None,
        m.Meaning("gap between the seated part and the straight beam; snap_fit only"),
        _world_range("clearance"),
        _world_default("clearance"),
    ] = None
    plug_width: Annotated[
        Length | None,
        m.Meaning("width of the plug; outlet only"),
        _world_range("plug_width"),
        _world_default("plug_width"),
    ] = None
    opening: Annotated[
        Length | None,
        m.Meaning("distance between the two hooks; outlet only"),
        _world_range("opening"),
        _world_default("opening"),
    ] = None
    arm: Annotated[
        Length | None,
        m.Meaning("distance from the plug's inner end to the hooks when it is home; outlet only"),
        _world_range("arm"),
        _world_default("arm"),
    ] = None
    lead_in: Annotated[
        Length | None,
        m.Meaning("length of the plug's bevelled end; outlet only"),
        _world_range("lead_in"),
        _world_default("lead_in"),
    ] = None


#: world → the keys that only its designs have
ONLY = {"snap_fit": ("half_width", "clearance"), "outlet": ("plug_width", "opening", "arm", "lead_in")}


def _check_world(text: str) -> str:
    if text not in ONLY and not is_world_file(text):
        raise ValueError(f"must be 'snap_fit', 'outlet' or a file FILE.py:NAME; got {quote(text)}")
    return text


class DesignFile(BaseModel):
    """A file of candidate designs: what they are made of, what they share, and one table for each."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    title: Annotated[str, m.Meaning("title of the file"), m.Form("text")]
    world: Annotated[
        str,
        AfterValidator(_check_world),
        m.Meaning(
            "kind of design: a part that snaps in (snap_fit), a socket with a plug (outlet), or a world of your own"
        ),
        m.Form("snap_fit, outlet or FILE.py:NAME"),
    ]
    beam: Annotated[Model, m.Meaning("beam model: Timoshenko's, loaded where the contact is, or the paper's")] = (
        "timoshenko"
    )
    force_scale: Annotated[
        float, Field(ge=1e-6, le=1e6, strict=True), m.Meaning("factor on all torques of the handle")
    ] = 1.0
    common: Annotated[
        dict[str, Any],
        m.Meaning("keys common to all designs; a design may override them"),
        m.Form("the keys of [design.NAME]"),
        m.Without("none"),
    ] = Field(default_factory=dict)
    design: Annotated[
        dict[DesignName, dict[str, Any]], m.Meaning("the designs: one table [design.NAME] each"), m.Form("1 to 100")
    ] = Field(min_length=1, max_length=100)
