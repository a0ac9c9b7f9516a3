"""Candidate designs of a snap-fit file as renderable worlds; every mistake is reported."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, Literal

from annotated_types import Gt
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from haptorb.beams import MATERIALS, METALS_FROM, Hook, Model
from haptorb.cli.own_code import start_world_file
from haptorb.control.linkage import Gains
from haptorb.devices import quantity as q
from haptorb.devices import schema as m
from haptorb.devices.schema import explain_mistakes
from haptorb.errors import HaptorbError, InputError, quote
from haptorb.file_kind import FileKind
from haptorb.files import parse_toml, read_text
from haptorb.worlds import Outlet, SnapFit, World
from haptorb.worlds.base import Parameter, parameters
from haptorb.worlds.base import values as parameter_values
from haptorb.worlds.snap_fit import RootLoad
from haptorb.worlds.user_world import WorldFile, is_world_file, parse_world_file

__all__ = ["OWN_KEYS", "Candidate", "Candidates", "DesignFile", "DesignTable", "load_designs", "own_candidate"]


# --------------------------------------------------------------------------------------------------
# Design file: hook dimensions, angles, material; validated as a whole, every mistake is reported.
#
# title = "Cover clip" world = "snap_fit"               # or "outlet", or a world of your own: "groove.py:Groove", with
# its parameters beam = "timoshenko"              # or "paper" force_scale = 1.0                # all torques of the
# handle times this
#
# [common]                         # what the designs share; a design may say otherwise material = "ABS" friction = 0.3
# width = "6 mm"
#
# [design.slender] base_length = "15 mm" peak = "18.5 mm" thickness = "1.5 mm" height = "1.5 mm" insertion = "30 deg"
# retention = "45 deg" top = "flat"                     # a flat top joins the end of the rear face to the peak


Positive = Gt(0)
DesignName = Annotated[str, Field(pattern=r"^[^\x00-\x1f\x7f-\x9f/]+$", max_length=64)]  #: also of trace files
Length = Annotated[q.Length, Positive]
Angle = Annotated[q.Angle, Positive]
Modulus = Annotated[q.Modulus, Positive]


def _world_range(key: str) -> m.Form:
    """Permitted range of `key`, in mm, GPa or degrees."""
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
    """Default of `key`, a length, in the file's world."""
    known = next(found for world in (SnapFit, Outlet) if (found := parameters(world).get(key)))
    return m.Without(f"{1e3 * float(known.default):g} mm" if isinstance(known.default, int | float) else "")


class DesignTable(BaseModel):
    """One [design.NAME] merged with [common]."""

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


#: world → keys that only its designs have
OWN_KEYS = {"snap_fit": ("half_width", "clearance"), "outlet": ("plug_width", "opening", "arm", "lead_in")}


def _check_world(text: str) -> str:
    if text not in OWN_KEYS and not is_world_file(text):
        raise ValueError(f"must be 'snap_fit', 'outlet' or a file FILE.py:NAME; got {quote(text)}")
    return text


class DesignFile(BaseModel):
    """File of candidate designs: world, common values, and one table for each design."""

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


_MAX_MISTAKES = 40  #: reported at once


@dataclass(frozen=True)
class Candidate:
    """Candidate design of a snap-fit or another world, as it is rendered.

    Parameters
    ----------
    name : str
        Name in the design file.
    title : str
        Title of the design.
    material : str
        Material; empty for a world of the user's own.
    world : World
        World that renders the design.
    remarks : tuple of str
        Remarks about the design.
    digest : str
        Digest of everything that determines its force; ratings and traces refer to it.
    root : RootLoad, optional
        Load at the root of the hook at its largest deflection; None for a world without a hook.
    """

    name: str
    title: Annotated[str, m.Meaning("title of the file"), m.Form("text")]
    material: str
    world: Annotated[
        World, m.Meaning("kind of design: a part that snaps in (snap_fit), or a socket with a plug (outlet)")
    ]
    remarks: tuple[str, ...]
    digest: str
    root: RootLoad | None = None

    @property
    def hook(self) -> Hook | None:
        """Its hook; None for a user's own world."""
        return self.world.hook if isinstance(self.world, SnapFit | Outlet) else None


@dataclass(frozen=True)
class Candidates:
    """Designs of a file, in its order; `designs["name"]` is one of them.

    Parameters
    ----------
    title : str
        Title of the file.
    beam : Model
        Beam model: Timoshenko's, loaded where the contact is, or the paper's.
    gains : Gains
        Gains of the motor's modes.
    designs : tuple of Candidate
        The designs.
    """

    title: Annotated[str, m.Meaning("title of the file"), m.Form("text")]
    beam: Annotated[Model, m.Meaning("beam model: Timoshenko's, loaded where the contact is, or the paper's")]
    gains: Gains
    designs: tuple[Candidate, ...]

    def __getitem__(self, name: str) -> Candidate:
        for design in self.designs:
            if design.name == name:
                return design
        raise InputError(f"unknown design '{name}'; known: {', '.join(d.name for d in self.designs)}")


def load_designs(path: str | Path) -> Candidates:
    """Load the designs of a file for `haptorb feel`.

    Parameters
    ----------
    path : str or Path
        TOML file with the designs.

    Returns
    -------
    FeelDesigns
        The designs, in the order of the file.

    Raises
    ------
    InputError
        With every mistake: file, design, key, value and what was expected; among them sizes that contradict each other,
        with the amount (erratum E8).
    """
    where = str(path)
    text = read_text(path, "snap-fit file", InputError, kind=FileKind.FELT_DESIGNS)
    try:
        raw = parse_toml(text)
    except ValueError as cause:
        raise InputError(f"{where}: is not TOML ({cause})") from cause
    try:
        file = DesignFile.model_validate(raw)
    except ValidationError as cause:
        raise InputError(_list_mistakes(where, explain_mistakes(cause.errors(), DesignFile))) from cause
    own_file = parse_world_file(file.world, Path(path).parent) if is_world_file(file.world) else None
    mistakes = [] if own_file else [f"common: {line}" for line in _mistakes_of_common(file.common)]
    common = {key: value for key, value in file.common.items() if key in DesignTable.model_fields}
    designs = []
    for name, own in file.design.items():
        try:
            if own_file is None:
                designs.append(_candidate(name, file, {**common, **own}))
            else:
                designs.append(own_candidate(own_file, name, {**file.common, **own}))
        except ValidationError as cause:
            errors = [error for error in cause.errors() if error["loc"][0] in own or error["loc"][0] not in common]
            mistakes += [f"design {quote(name)}: {line}" for line in explain_mistakes(errors, DesignTable)]
        except HaptorbError as cause:
            mistakes.append(f"design {quote(name)}: {cause}")
    if mistakes:
        raise InputError(_list_mistakes(where, mistakes))
    gains = Gains() if file.force_scale == 1.0 else Gains().scale(file.force_scale)
    return Candidates(file.title, file.beam, gains, tuple(designs))


def _list_mistakes(where: str, mistakes: list[str]) -> str:
    more = [f"and {len(mistakes) - _MAX_MISTAKES} more mistakes"] if len(mistakes) > _MAX_MISTAKES else []
    return (
        f"{where}: {mistakes[0]}"
        if len(mistakes) == 1
        else "\n  ".join([f"{where}:", *mistakes[:_MAX_MISTAKES], *more])
    )


def _material(name: str, design: DesignTable) -> tuple[float, float, bool]:
    known = MATERIALS.get(design.material)
    E, nu = design.youngs_modulus, design.poisson_ratio
    if known is None and (E is None or nu is None):
        near = get_close_matches(design.material[:60], MATERIALS, n=1, cutoff=0.5)
        raise InputError(
            f"material {quote(design.material)} is not known"
            + (f"; did you mean '{near[0]}'?" if near else "")
            + f" (known: {', '.join(MATERIALS)}); give youngs_modulus and poisson_ratio with it"
        )
    metal = design.metal if design.metal is not None else bool(known and known[2])
    return (
        E if E is not None else known[0],  # type: ignore[index]
        nu if nu is not None else known[1],  # type: ignore[index]
        metal,
    )


def _mistakes_of_common(common: dict[str, Any]) -> list[str]:
    """Mistakes in [common], reported once instead of for every design."""
    try:
        DesignTable.model_validate(common)
    except ValidationError as cause:
        return explain_mistakes((error for error in cause.errors() if error["type"] != "missing"), DesignTable)
    return []


def _candidate(name: str, file: DesignFile, values: dict[str, Any]) -> Candidate:
    design = DesignTable.model_validate(values)
    for world, keys in OWN_KEYS.items():
        wrong = [key for key in keys if world != file.world and getattr(design, key) is not None]
        if wrong:
            raise InputError(f"{wrong[0]} is a key of world '{world}', but this file is for world '{file.world}'")
    E, nu, metal = _material(name, design)
    hook = Hook(
        design.base_length, design.peak, design.thickness, design.height, design.width, design.insertion,
        design.retention, E, nu, flat_top=design.top == "flat",
    )  # fmt: skip
    others = {key: getattr(design, key) for key in OWN_KEYS[file.world] if getattr(design, key) is not None}
    kind: type[SnapFit] | type[Outlet] = SnapFit if file.world == "snap_fit" else Outlet
    made = kind.of(hook, design.friction, file.beam, material=design.material, **others)
    remarks = list(hook.remarks(metal))
    root = replace(made.root_load, stated_strength=design.yield_strength)
    if root.beyond_yield or root.breaks:
        remarks.append(root.sentence)
    if design.material in MATERIALS and MATERIALS[design.material].metal is not metal:
        remarks.append(f"material '{design.material}' is {'a metal' if not metal else 'no metal'}, but metal = {metal}")
    if not metal and METALS_FROM < E:
        remarks.append(
            f"youngs_modulus {E / 1e9:.4g} GPa is typical of a metal; is '{design.material}' one? (metal = true)"
        )
    parts = {**hook.__dict__, **others, "friction": design.friction, "world": file.world, "beam": file.beam}
    digest = hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:16]
    return Candidate(name, design.title or name, design.material, made, tuple(remarks), digest, root)


def own_candidate(file: WorldFile, name: str, values: dict[str, Any]) -> Candidate:
    """The world in `file` as a design: `values` of its parameters (SI, or text with a unit), and a `title`.

    It is loaded once, so that it does not change during a session. Raises InputError as `WorldFile.load` does, and for
    invalid values.
    """
    world = start_world_file(file)
    known = parameters(type(world))
    title = str(values.get("title", "")) or name
    given = {key: value for key, value in values.items() if key != "title"}
    made = world.replace(**{key: _own_value(key, value, known) for key, value in given.items()})
    parts = {"file": file.path.read_bytes().hex(), "name": made.name, "values": parameter_values(made)}
    digest = hashlib.sha256(json.dumps(parts, sort_keys=True, default=list).encode()).hexdigest()[:16]
    return Candidate(name, title, "", made, (), digest)


def _own_value(key: str, value: Any, known: dict[str, Parameter]) -> Any:
    if not isinstance(value, str) or key not in known:
        return value
    unit = known[key].unit.removeprefix("1")
    try:
        return q.si(value, unit, f"a value in {unit}" if unit else "a number without a unit")
    except ValueError as cause:
        raise InputError(f"{key} {cause}") from cause
