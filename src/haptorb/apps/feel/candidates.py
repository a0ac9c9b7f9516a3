"""Candidate designs P out of a design file, as worlds that can be felt; every mistake named."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any

from pydantic import ValidationError

from haptorb.apps.feel.design_file import ONLY, DesignFile, DesignTable
from haptorb.apps.own_code import start_world_file
from haptorb.control.clutch.gains import Gains
from haptorb.devices.schema import key as m
from haptorb.devices.schema import quantity as q
from haptorb.devices.schema.mistakes import explain_mistakes
from haptorb.errors import HaptorbError, InputError, quote
from haptorb.files.file_kind import FileKind
from haptorb.files.text_file import parse_toml, read_text
from haptorb.physics.beams import Model
from haptorb.physics.hook import METALS_FROM, Hook
from haptorb.physics.materials import MATERIALS
from haptorb.worlds import Outlet, SnapFit, World
from haptorb.worlds.own.world_file import WorldFile, is_world_file, parse_world_file
from haptorb.worlds.parameter import Parameter, parameters
from haptorb.worlds.parameter import values as parameter_values
from haptorb.worlds.snap_fit.root_load import RootLoad

__all__ = ["Candidate", "Candidates", "load_designs", "own_candidate"]

_MISTAKES = 40  #: reported at once


@dataclass(frozen=True)
class Candidate:
    """One design as it can be felt."""

    name: str
    title: Annotated[str, m.Meaning("title of the file"), m.Form("text")]
    material: str  #: empty for a world of the user's own
    world: Annotated[
        World, m.Meaning("kind of design: a part that snaps in (snap_fit), or a socket with a plug (outlet)")
    ]
    remarks: tuple[str, ...]  #: what should be said about it though it can exist
    digest: str  #: of everything that makes its feel; ratings and traces carry it
    root: RootLoad | None = None  #: what the hook's root bears where it is bent most; None for a world without a hook

    @property
    def hook(self) -> Hook | None:
        """The hook it is about; None for a world of the user's own."""
        return self.world.hook if isinstance(self.world, SnapFit | Outlet) else None


@dataclass(frozen=True)
class Candidates:
    """A file's designs, in its order."""

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
    """The designs in the TOML file at `path`.

    Raises InputError with every mistake: file, design, key, value and what was expected; among them sizes that
    contradict each other, with the amount (erratum E8).
    """
    where = str(path)
    text = read_text(path, "design file", InputError, kind=FileKind.FELT_DESIGNS)
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
    more = [f"and {len(mistakes) - _MISTAKES} more mistakes"] if len(mistakes) > _MISTAKES else []
    return f"{where}: {mistakes[0]}" if len(mistakes) == 1 else "\n  ".join([f"{where}:", *mistakes[:_MISTAKES], *more])


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
    """Mistakes in [common] itself: reported once, and not for every design."""
    try:
        DesignTable.model_validate(common)
    except ValidationError as cause:
        return explain_mistakes((error for error in cause.errors() if error["type"] != "missing"), DesignTable)
    return []


def _candidate(name: str, file: DesignFile, values: dict[str, Any]) -> Candidate:
    design = DesignTable.model_validate(values)
    for world, keys in ONLY.items():
        wrong = [key for key in keys if world != file.world and getattr(design, key) is not None]
        if wrong:
            raise InputError(f"{wrong[0]} is a key of world '{world}', but this file is for world '{file.world}'")
    E, nu, metal = _material(name, design)
    hook = Hook(
        design.base_length, design.peak, design.thickness, design.height, design.width, design.insertion,
        design.retention, E, nu, flat_top=design.top == "flat",
    )  # fmt: skip
    others = {key: getattr(design, key) for key in ONLY[file.world] if getattr(design, key) is not None}
    kind: type[SnapFit] | type[Outlet] = SnapFit if file.world == "snap_fit" else Outlet
    made = kind.of(hook, design.friction, file.beam, material=design.material, **others)
    remarks = list(hook.remarks(metal))
    root = replace(made.root_load, stated_strength=design.yield_strength)
    if root.beyond_yield:
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
    """The world in `file` as a design: `values` of its parameters (SI, or texts with a unit), and a `title`.

    It is loaded once: what is felt and rated stays what it was when the session began. Raises InputError as
    `WorldFile.load` does, and for values that cannot be.
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
