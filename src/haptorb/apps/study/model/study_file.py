"""What a study file says: what is asked, of what, how often and in which order."""

from __future__ import annotations

from hashlib import sha256
from typing import Annotated, Any, Literal, Self

from pydantic import Field, PrivateAttr, model_validator

from haptorb import worlds
from haptorb.apps.study.model.analysis_plan import AnalysisPlan, HandAngle, check_plan
from haptorb.apps.study.model.set_points import SetPoint, list_equal_rings, list_published
from haptorb.apps.study.model.study_checks import check_levels
from haptorb.apps.study.model.study_parts import (
    Condition,
    Levels,
    Mask,
    Name,
    Part,
    Places,
    ProcedureName,
    Question,
    RatingScale,
    RenderChoice,
    Trials,
    Value,
)
from haptorb.devices.electromagnet.api import electromagnet
from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.devices.loader import load
from haptorb.devices.schema import key as m
from haptorb.errors import InputError
from haptorb.worlds.own.world_file import is_world_file
from haptorb.worlds.parameter import Parameter, parameters
from haptorb.worlds.world import World

__all__ = ["Study"]

#: left out of the digest where they are not used: studies that began before these existed continue
_LATER = ("mask", "questions", "model", "render", "world_digest", "published_layout", "order_version", "hand_deg")
_LEVELLED = ("constant", "staircase", "bayesian", "magnitude")


class Study(Part):
    """One study; `text` is the file as it was read, kept with the data."""

    name: Annotated[Name, m.Meaning("name of the study")]
    device: Annotated[
        str, m.Meaning("device that the participants use"), m.Form("name in the catalogue, or path of a device file")
    ] = "omni"
    world: Annotated[
        str,
        m.Meaning("world to render; it must have a parameter summit"),
        m.Form("name in the catalogue, or FILE.py:NAME beside the study file"),
    ] = "dome"
    world_digest: Annotated[
        str,
        Field(pattern="^([0-9a-f]{64})?$"),
        m.Meaning("SHA-256 of the world's file; added by haptorb"),
        m.Form("64 hexadecimal digits"),
        m.Without("computed"),
    ] = ""
    published_layout: Annotated[
        Literal["", "1-4-8-12"],
        m.Meaning('meaning of the layout "published"; added by haptorb; a stored study without it has 1 + 8 + 8 + 8'),
        m.Without("computed"),
    ] = ""
    order_version: Annotated[
        Literal["", "2"],
        m.Meaning("version of the rules for the order of trials; added by haptorb; without it, the older rules apply"),
        m.Without("computed"),
    ] = ""
    model: Annotated[
        str,
        m.Meaning("controller model"),
        m.Form("one of the device's models that a loop can use"),
        m.Without("the device's first model"),
    ] = ""
    render: RenderChoice = ""
    procedure: Annotated[
        ProcedureName,
        m.Meaning("procedure: the question of each trial"),
    ] = "identification"
    instructions: Annotated[str, m.Meaning("text that the participant reads first"), m.Form("text")] = (
        "Find the place where the dome pushes hardest, then answer with its number."
    )
    consent: Annotated[
        str,
        m.Meaning("text that the participant agrees to before the first trial"),
        m.Form("text"),
        m.Without("none is asked for"),
    ] = ""
    parameters: Annotated[
        dict[str, Value],
        m.Meaning("parameters of the world in every condition"),
        m.Form("NAME = number or [x, y, z]; `haptorb worlds NAME` lists them"),
        m.Without("the world's defaults"),
    ] = Field(default_factory=dict)
    set_points: Annotated[
        Places, m.Meaning("places on the dome that trials present"), m.Without("the published layout")
    ] = Places(layout="published")
    trials: Annotated[Trials, m.Meaning("repetitions, order and breaks"), m.Without("the defaults below")] = Trials()
    conditions: Annotated[
        tuple[Condition, ...],
        Field(max_length=100),
        m.Meaning("variants of the world to compare"),
        m.Form("1 to 100, each with its own name; 2 or more for forced-choice"),
        m.Without("one, called base"),
    ] = (Condition(name="base"),)
    levels: Annotated[
        Levels | None,
        m.Meaning("parameter that a comparison varies"),
        m.Without("none: required with procedures constant, staircase, bayesian and magnitude"),
    ] = None
    rating: Annotated[RatingScale, m.Meaning("question and scale of a rating"), m.Without("the defaults below")] = (
        RatingScale()
    )
    mask: Annotated[Mask | None, m.Meaning("noise for the participant's headphones"), m.Without("none")] = None
    questions: Annotated[
        tuple[Question, ...],
        Field(max_length=200),
        m.Meaning("questions before or after the trials"),
        m.Form("at most 200, each with its own name"),
        m.Without("none"),
    ] = ()
    hand_deg: HandAngle = None
    plan: Annotated[
        AnalysisPlan | None, m.Meaning("plan of the analysis, decided before data exist"), m.Without("none")
    ] = None
    _text: str = PrivateAttr("")
    _own: World | None = PrivateAttr(None)

    @model_validator(mode="before")
    @classmethod
    def _keep_older_order(cls, raw: Any) -> Any:
        """A study of older rules that names no order is in random order, as it was run."""
        if isinstance(raw, dict) and not raw.get("order_version") and isinstance(raw.get("trials", {}), dict):
            return {**raw, "trials": {"order": "random", **raw.get("trials", {})}}
        return raw

    @model_validator(mode="after")
    def _check_names(self) -> Self:
        names = [condition.name for condition in self.conditions]
        if not names:
            raise ValueError("conditions must not be empty; leave out the key for a single condition")
        if len(set(names)) < len(names):
            raise ValueError(f"condition names must differ; got {', '.join(names)}")
        asked = [question.name for question in self.questions]
        if len(set(asked)) < len(asked):
            raise ValueError(f"names of questions must differ; got {', '.join(asked)}")
        if self.procedure in _LEVELLED:
            check_levels(self)
        elif self.levels is not None:
            raise ValueError(f"[levels] needs procedure {', '.join(_LEVELLED)}; this study has '{self.procedure}'")
        if self.procedure == "forced-choice" and len(names) < 2:
            raise ValueError("a forced choice needs at least two conditions to choose between")
        check_plan(self, self.plan)
        return self

    @property
    def text(self) -> str:
        """The study file, word for word; before it the digest of a world's file, and the layout called published."""
        return self._text

    @property
    def own_world(self) -> World | None:
        """The world of FILE.py:NAME; None for one of the catalogue, and for a study out of a database."""
        return self._own

    @property
    def world_name(self) -> str:
        """What a servo calls the world."""
        return self.world if self._own is None else self._own.name

    @property
    def known_parameters(self) -> dict[str, Parameter]:
        """The world's parameters by name; none for a user's own where its file was not read."""
        if is_world_file(self.world):
            return {} if self._own is None else parameters(type(self._own))
        return parameters(worlds.find_world(self.world))

    @property
    def digest(self) -> str:
        """Of all that decides how it runs: sessions of one study share it. The plan of the analysis has its own."""
        unused = {name for name in _LATER if getattr(self, name) in (None, "", ())}
        return sha256(self.model_dump_json(exclude={"plan", *unused}).encode()).hexdigest()[:16]

    @property
    def points(self) -> tuple[SetPoint, ...]:
        """The set-points, built in or its own."""
        if self.set_points.layout == "published" and self.published_layout:
            return list_published()
        if self.set_points.layout:
            return list_equal_rings()
        return tuple(SetPoint(p.number, p.theta_deg, p.phi_deg) for p in self.set_points.points)

    def with_text(self, text: str, update: dict[str, Any]) -> Study:
        """With other values under the keys of `update`, and the matching `text`."""
        found = self.model_copy(update=update)
        found._text = text
        return found

    def with_world(self, world: World) -> Study:
        """With the `world` of its FILE.py:NAME."""
        found = self.model_copy()
        found._own = world
        return found

    def point(self, number: int) -> SetPoint:
        """The set-point called `number`."""
        return next(point for point in self.points if point.number == number)

    def values(self, condition: str, number: int = 0, level: float | None = None) -> dict[str, Any]:
        """The world's parameters in `condition`, with the summit at a set-point and the varied one at `level`."""
        chosen = next(c for c in self.conditions if c.name == condition)
        values: dict[str, Any] = {**self.parameters, **chosen.parameters}
        if number:
            values["summit"] = self.point(number).direction
        if level is not None and self.levels is not None:
            values[self.levels.parameter] = level
        return values

    @property
    def level_unit(self) -> str:
        """Unit of the parameter that the levels vary; empty for plain numbers, and where nothing is varied."""
        known = None if self.levels is None else self.known_parameters.get(self.levels.parameter)
        return "" if known is None else known.unit

    def make_world(self, condition: str, number: int = 0, level: float | None = None) -> World:
        """The world of one trial. Raises InputError for a user's own whose file was not read."""
        if self._own is None and is_world_file(self.world):
            raise InputError(f"world '{self.world}' is loaded only with its study file, not from a database")
        fresh = worlds.find_world(self.world)() if self._own is None else self._own
        return fresh.replace(**self.values(condition, number, level))

    def load_device(self) -> SphericalElectromagnet:
        """The device; InputError if it has no dome to find places on."""
        return electromagnet(load(self.device), "a study with set-points on a dome")
