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

import hashlib
import json
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, Literal

from annotated_types import Gt
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from haptorb.apps.feel.materials import MATERIALS, YIELD_STRENGTHS
from haptorb.control.clutch.modes import Gains
from haptorb.devices.schema import quantity as q
from haptorb.errors import HaptorbError, InputError, quote
from haptorb.files.text_file import parse_toml, read_text
from haptorb.physics.beams import Model
from haptorb.physics.hook import METALS_FROM, Hook
from haptorb.worlds import Outlet, SnapFit, World
from haptorb.worlds.own.world_file import WorldFile, is_world_file, parse_world_file
from haptorb.worlds.parameter import Parameter, parameters
from haptorb.worlds.parameter import values as parameter_values

__all__ = ["MATERIALS", "Candidate", "Candidates", "load_designs", "own_candidate"]

_MISTAKES = 40  #: told at once

Positive = Gt(0)
DesignName = Annotated[str, Field(pattern=r"^[^\x00-\x1f\x7f-\x9f/]+$", max_length=64)]  #: also of files of traces
Length = Annotated[q.Length, Positive]
Angle = Annotated[q.Angle, Positive]
Modulus = Annotated[float, BeforeValidator(lambda value: q.si(value, "Pa", "a modulus of elasticity")), Positive]
Strength = Annotated[float, BeforeValidator(lambda value: q.si(value, "Pa", "a stress at yield")), Positive]


class _Design(BaseModel):
    """One [design.NAME], with [common] filled in."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    title: str = ""
    material: str
    metal: Annotated[bool, Field(strict=True)] | None = None
    youngs_modulus: Modulus | None = None
    poisson_ratio: Annotated[float, Field(ge=0, lt=0.5, strict=True)] | None = None
    yield_strength: Strength | None = None
    friction: Annotated[float, Field(ge=0, le=1, strict=True)]
    base_length: Length
    peak: Length
    thickness: Length
    height: Length
    width: Length
    insertion: Angle = Field(default="30 deg", validate_default=True)
    retention: Angle
    top: Literal["sharp", "flat"] = "sharp"
    half_width: Length | None = None
    clearance: q.Length | None = None
    plug_width: Length | None = None
    opening: Length | None = None
    arm: Length | None = None
    lead_in: Length | None = None


_ONLY = {"snap_fit": ("half_width", "clearance"), "outlet": ("plug_width", "opening", "arm", "lead_in")}


def _check_world(text: str) -> str:
    if text not in _ONLY and not is_world_file(text):
        raise ValueError("must be 'snap_fit', 'outlet' or a file FILE.py:NAME")
    return text


class _File(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    title: str
    world: Annotated[str, AfterValidator(_check_world)]
    beam: Model = "timoshenko"
    force_scale: Annotated[float, Field(ge=1e-6, le=1e6, strict=True)] = 1.0
    common: dict[str, Any] = Field(default_factory=dict)
    design: dict[DesignName, dict[str, Any]] = Field(min_length=1, max_length=100)


@dataclass(frozen=True)
class Candidate:
    """One design as it can be felt."""

    name: str
    title: str
    material: str  #: empty for a world of the user's own
    world: World
    remarks: tuple[str, ...]  #: what should be said about it though it can exist
    digest: str  #: of everything that makes its feel; ratings and traces carry it
    yield_strength: float | None = None  #: stress at which the material yields [Pa], where it is known

    @property
    def hook(self) -> Hook | None:
        """The hook it is about; None for a world of the user's own."""
        return self.world.hook if isinstance(self.world, SnapFit | Outlet) else None


@dataclass(frozen=True)
class Candidates:
    """A file's designs, in its order."""

    title: str
    beam: Model
    gains: Gains
    designs: tuple[Candidate, ...]

    def __getitem__(self, name: str) -> Candidate:
        for design in self.designs:
            if design.name == name:
                return design
        raise InputError(f"unknown design '{name}'; known: {', '.join(d.name for d in self.designs)}")


def load_designs(path: str | Path) -> Candidates:
    """The designs in the TOML file at `path`.

    Raises InputError with every mistake: file, design, key, value and what was expected; among them sizes that
    contradict each other, with the amount (erratum E8).
    """
    where = str(path)
    text = read_text(path, "design file", InputError)
    try:
        raw = parse_toml(text)
    except ValueError as cause:
        raise InputError(f"{where}: is not TOML ({cause})") from cause
    try:
        file = _File.model_validate(raw)
    except ValidationError as cause:
        raise InputError(_list_mistakes(where, [_explain_error(error, _File) for error in cause.errors()])) from cause
    mistakes: list[str] = []
    designs = []
    own_file = parse_world_file(file.world, Path(path).parent) if is_world_file(file.world) else None
    for name, own in file.design.items():
        values = {**file.common, **own}
        try:
            designs.append(
                _candidate(name, file, values) if own_file is None else own_candidate(own_file, name, values)
            )
        except ValidationError as cause:
            mistakes += [f"design {quote(name)}: {_explain_error(error, _Design)}" for error in cause.errors()]
        except HaptorbError as cause:
            mistakes.append(f"design {quote(name)}: {cause}")
    if mistakes:
        raise InputError(_list_mistakes(where, mistakes))
    gains = Gains() if file.force_scale == 1.0 else Gains().scale(file.force_scale)
    return Candidates(file.title, file.beam, gains, tuple(designs))


def _list_mistakes(where: str, mistakes: list[str]) -> str:
    more = [f"and {len(mistakes) - _MISTAKES} more mistakes"] if len(mistakes) > _MISTAKES else []
    return f"{where}: {mistakes[0]}" if len(mistakes) == 1 else "\n  ".join([f"{where}:", *mistakes[:_MISTAKES], *more])


def _explain_error(error: Any, model: type[BaseModel]) -> str:
    key = ".".join(quote(part)[1:-1] if isinstance(part, str) else str(part) for part in error["loc"])
    if error["type"] == "extra_forbidden":
        near = get_close_matches(key[:60], model.model_fields, n=1, cutoff=0.6)
        return f"{key} is not a key of this file" + (f"; did you mean '{near[0]}'?" if near else "")
    if error["type"] == "missing":
        return f"{key} is missing"
    message = str(error["msg"]).removeprefix("Value error, ")
    got = "" if "got" in message else f"; got {quote(error['input'])}"
    return f"{key} {message[:1].lower()}{message[1:]}{got}"


def _material(name: str, design: _Design) -> tuple[float, float, bool]:
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


def _candidate(name: str, file: _File, values: dict[str, Any]) -> Candidate:
    design = _Design.model_validate(values)
    for world, keys in _ONLY.items():
        wrong = [key for key in keys if world != file.world and getattr(design, key) is not None]
        if wrong:
            raise InputError(f"{wrong[0]} is a key of world '{world}', but this file is for world '{file.world}'")
    E, nu, metal = _material(name, design)
    hook = Hook(
        design.base_length, design.peak, design.thickness, design.height, design.width, design.insertion,
        design.retention, E, nu, flat_top=design.top == "flat",
    )  # fmt: skip
    others = {key: getattr(design, key) for key in _ONLY[file.world] if getattr(design, key) is not None}
    kind: type[SnapFit] | type[Outlet] = SnapFit if file.world == "snap_fit" else Outlet
    made = kind.of(hook, design.friction, file.beam, **others)
    remarks = list(hook.remarks(metal))
    if design.material in MATERIALS and MATERIALS[design.material][2] is not metal:
        remarks.append(f"material '{design.material}' is {'a metal' if not metal else 'no metal'}, but metal = {metal}")
    if not metal and METALS_FROM < E:
        remarks.append(
            f"youngs_modulus {E / 1e9:.4g} GPa is typical of a metal; is '{design.material}' one? (metal = true)"
        )
    parts = {**hook.__dict__, **others, "friction": design.friction, "world": file.world, "beam": file.beam}
    digest = hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:16]
    strength = design.yield_strength or YIELD_STRENGTHS.get(design.material)
    return Candidate(name, design.title or name, design.material, made, tuple(remarks), digest, strength)


def own_candidate(file: WorldFile, name: str, values: dict[str, Any]) -> Candidate:
    """The world in `file` as a design: `values` of its parameters (SI, or texts with a unit), and a `title`.

    It is loaded once: what is felt and rated stays what it was when the session began. Raises InputError as
    `WorldFile.load` does, and for values that cannot be.
    """
    world = file.load()
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
