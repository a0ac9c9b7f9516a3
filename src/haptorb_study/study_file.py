"""Study file (TOML): device, world, procedure, trials, conditions and plan, validated as a whole."""

from __future__ import annotations

from hashlib import sha256
from pathlib import Path, PurePath
from typing import Annotated, Any, Literal, Self

from pydantic import Field, PrivateAttr, ValidationError, model_validator

from haptorb import worlds
from haptorb.cli.own_code import start_world_file
from haptorb.devices import schema as m
from haptorb.devices.api import electromagnet
from haptorb.devices.electromagnet import SphericalElectromagnet
from haptorb.devices.loader import in_catalogue, load
from haptorb.devices.schema import explain_mistakes
from haptorb.errors import InputError, quote
from haptorb.file_kind import FileKind
from haptorb.files import named_file, parse_toml, read_bytes, read_text
from haptorb.terminal import announce_wait
from haptorb.worlds.base import Parameter, World, check_names, parameters
from haptorb.worlds.user_world import WorldFile, fit_world, is_world_file, parse_world_file, try_world
from haptorb_study.analysis_plan import AnalysisPlan, HandAngle, check_plan
from haptorb_study.set_points import SetPoint, list_equal_rings, list_published
from haptorb_study.study_tables import (
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

__all__ = ["Study", "check_levels", "check_study", "list_older", "read_study", "study_of"]


# --------------------------------------------------------------------------------------------------
# Consistency of a study: levels for its procedure, and worlds that its device can render.


def check_levels(study: Study) -> None:
    """Raise ValueError unless [levels] fit the procedure."""
    levels = study.levels
    if levels is None:
        raise ValueError(f"procedure '{study.procedure}' needs [levels] with at least parameter and reference")
    if study.procedure == "constant":
        if len(set(levels.values)) < 2:
            raise ValueError("constant stimuli need at least two different levels.values")
    elif study.procedure == "magnitude":
        if len(set(levels.values)) < 2 or min(levels.values) <= 0 or levels.reference <= 0:
            raise ValueError(
                "magnitude estimation needs two different levels.values or more, all above 0; reference too"
            )
    elif levels.least is None or levels.most is None or not levels.least < levels.most:
        raise ValueError(f"procedure '{study.procedure}' needs levels.least < levels.most, both differences > 0")
    elif study.procedure == "staircase" and (levels.start is None or not levels.least <= levels.start <= levels.most):
        raise ValueError("a staircase needs levels.start between levels.least and levels.most")


def check_study(study: Study) -> None:
    """Raise InputError unless the device can render every condition, level and set-point."""
    kind = worlds.find_world(study.world) if study.own_world is None else type(study.own_world)
    for condition in study.conditions:
        check_names(kind, {**study.parameters, **condition.parameters})
        if "summit" in {**study.parameters, **condition.parameters}:
            raise InputError("parameters.summit is set by the set-points; leave it out")
    if "summit" not in parameters(kind):
        raise InputError(
            f"world '{study.world}' has no summit to move to a set-point; a study needs a world with a summit: dome"
        )
    device = study.load_device()
    if study.model:
        device.check_tick_model(study.model_on(device) or study.model)
    limit = device.workspace_half_angle * 180 / 3.141592653589793
    for point in study.points:
        if point.theta_deg > limit + 1e-9:
            raise InputError(
                f"set-point {point.number} at θ = {point.theta_deg:g} deg lies outside the workspace of device "
                f"'{device.name}', which ends at {limit:g} deg"
            )
    shown: list[float | None] = [None]
    if study.levels is not None:
        if study.levels.parameter not in parameters(kind):
            check_names(kind, {study.levels.parameter: 0.0})
        more = [level for level in (study.levels.least, study.levels.most, study.levels.start) if level is not None]
        shown = [study.levels.reference, *study.levels.values, *(study.levels.reference + m for m in more)]
    for condition in study.conditions:
        for level in shown:
            fit_world(study.make_world(condition.name, study.points[0].number, level), device)


#: excluded from the digest if unused, as no_force of a condition is: older studies keep their digest
_OPTIONAL_IN_DIGEST = (
    "mask", "questions", "model", "render", "world_digest", "published_layout", "order_version", "model_version",
    "hand_deg",
)  # fmt: skip


_PROCEDURES_WITH_LEVELS = ("constant", "staircase", "bayesian", "magnitude")


class Study(Part):
    """A study; `text` is the file verbatim, which is stored with the data."""

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
    model_version: Annotated[
        Literal["", "2"],
        m.Meaning('version of the models; added by haptorb; in a stored study without it "exact" is "point-coils"'),
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
    _devices: Path | None = PrivateAttr(None)

    @model_validator(mode="before")
    @classmethod
    def _default_older_order(cls, raw: Any) -> Any:
        """Default order "random" for studies without an order version, as they were run."""
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
        if self.procedure in _PROCEDURES_WITH_LEVELS:
            check_levels(self)
        elif self.levels is not None:
            raise ValueError(
                f"[levels] needs procedure {', '.join(_PROCEDURES_WITH_LEVELS)}; this study has '{self.procedure}'"
            )
        if self.procedure == "forced-choice" and len(names) < 2:
            raise ValueError("a forced choice needs at least two conditions to choose between")
        check_plan(self.procedure, names, self.plan)
        return self

    @property
    def text(self) -> str:
        """The study file verbatim, preceded by keys that haptorb added."""
        return self._text

    @property
    def own_world(self) -> World | None:
        """The user's own world FILE.py:NAME; None for catalogue worlds, and for a study from a database."""
        return self._own

    @property
    def world_name(self) -> str:
        """Name of the world in the servo."""
        return self.world if self._own is None else self._own.name

    @property
    def known_parameters(self) -> dict[str, Parameter]:
        """Parameters of the world by name; empty for a user's own world whose file was not read."""
        if is_world_file(self.world):
            return {} if self._own is None else parameters(type(self._own))
        return parameters(worlds.find_world(self.world))

    @property
    def digest(self) -> str:
        """Digest of all settings that affect how it runs, without the analysis plan: the identity of the study."""
        unused = {"plan"} | {name for name in _OPTIONAL_IN_DIGEST if getattr(self, name) in (None, "", ())}
        felt = {n: {"no_force"} for n, condition in enumerate(self.conditions) if not condition.no_force}
        text = self.model_dump_json(exclude={**dict.fromkeys(unused, True), "conditions": felt})
        return sha256(text.encode()).hexdigest()[:16]

    @property
    def points(self) -> tuple[SetPoint, ...]:
        """The set-points, built-in or the study's own."""
        if self.set_points.layout == "published" and self.published_layout:
            return list_published()
        if self.set_points.layout:
            return list_equal_rings()
        return tuple(SetPoint(p.number, p.theta_deg, p.phi_deg) for p in self.set_points.points)

    def with_text(self, text: str, update: dict[str, Any]) -> Study:
        """Copy with the values of `update`, and the matching `text`."""
        found = self.model_copy(update=update)
        found._text = text
        return found

    def with_world(self, world: World) -> Study:
        """Copy with the user's own `world`."""
        found = self.model_copy()
        found._own = world
        return found

    def point(self, number: int) -> SetPoint:
        """The set-point with this number."""
        return next(point for point in self.points if point.number == number)

    def values(self, condition: str, number: int = 0, level: float | None = None) -> dict[str, Any]:
        """World parameters in `condition`, with the summit at a set-point and the varied parameter at `level`."""
        chosen = next(c for c in self.conditions if c.name == condition)
        values: dict[str, Any] = {**self.parameters, **chosen.parameters}
        if number:
            values["summit"] = self.point(number).direction
        if level is not None and self.levels is not None:
            values[self.levels.parameter] = level
        return values

    @property
    def level_unit(self) -> str:
        """Unit of the varied parameter; empty if dimensionless or if nothing is varied."""
        known = None if self.levels is None else self.known_parameters.get(self.levels.parameter)
        return "" if known is None else known.unit

    def make_world(self, condition: str, number: int = 0, level: float | None = None) -> World:
        """World of one trial. Raises InputError for a user's own world whose file was not read."""
        if self._own is None and is_world_file(self.world):
            raise InputError(f"world '{self.world}' is loaded only with its study file, not from a database")
        fresh = worlds.find_world(self.world)() if self._own is None else self._own
        return fresh.replace(**self.values(condition, number, level))

    def load_device(self) -> SphericalElectromagnet:
        """Load the device; InputError if it has no dome, or lies elsewhere than a stored study may name it."""
        name = self.device if self._devices is None else _find_device(self.device, self._devices)
        return electromagnet(load(name), "a study with set-points on a dome")

    @property
    def devices(self) -> Path | None:
        """Only folder from which the device's file is read, for a stored study; None: any, the person's own study."""
        return self._devices

    def model_on(self, device: SphericalElectromagnet) -> str | None:
        """Controller model on `device`; None: its first. Older studies keep the model of point coils."""
        if not self.model_version and self.model in ("", "exact"):
            return "point-coils"
        return self.model or None


# --------------------------------------------------------------------------------------------------
# Reading a study file, with the keys that haptorb adds and the world's code.


#: current meaning of "published"; a stored study without the key ran with 1 + 8 + 8 + 8
_PUBLISHED_LAYOUT = "1-4-8-12"
#: current rules of the order; a stored study without the key keeps the older ones, at random by default
_ORDER_VERSION = "2"
#: current meaning of "exact"; a stored study without the key ran with point coils
_MODEL_VERSION = "2"
_MAX_MISTAKES = 20  #: mistakes reported at once
_MAX_WORLD_FILE_BYTES = 1 << 20  #: maximum size of a world's file [bytes]


def read_study(path: str | Path) -> Study:
    """Read the study file `path`; a user's own world is loaded, which runs its code.

    Raises InputError with place, cause and expected value of every mistake.
    """
    return study_of(
        read_text(path, "study file", InputError, kind=FileKind.STUDY), str(path), Path(path).expanduser().parent
    )


def study_of(
    text: str, where: str = "study", folder: Path | None = None, *, stored: bool = False, devices: Path | None = None
) -> Study:
    """Parse the study `text` (TOML); `where` names it in messages.

    folder   of the study file, the base of the path of a world's file; None: no file is read and no code is run, as for
             a study from a database
    stored   from a database: no keys are added, so that its meaning does not change
    devices  folder with the device's file of a stored study, which a stranger may have written; None: the current one
    """
    try:
        raw = parse_toml(text)
    except ValueError as cause:
        raise InputError(f"study file {where} is not TOML: {cause}") from cause
    for key, newest in (("order_version", _ORDER_VERSION), ("model_version", _MODEL_VERSION)):
        if not stored and key not in raw:
            raw[key], text = newest, f'{key} = "{newest}"\n{text}'
    try:
        study = Study.model_validate(raw).with_text(text, {})
        if stored:
            study._devices = devices or Path()
        if not stored and study.set_points.layout == "published" and not study.published_layout:
            study = _add_key(study, "published_layout", _PUBLISHED_LAYOUT)
        if is_world_file(study.world):
            if folder is None:
                return study
            study = _load_world(study, parse_world_file(study.world, folder))
        check_study(study)
    except ValidationError as cause:
        mistakes = explain_mistakes(cause.errors(), Study, _MAX_MISTAKES)
        lines = f" {mistakes[0]}" if len(mistakes) == 1 else "\n  ".join(["", *mistakes])
        raise InputError(f"study file {where}:{lines}") from cause
    except InputError as cause:
        raise InputError(f"study file {where}: {cause}") from cause
    return study


def _find_device(name: str, folder: Path) -> str:
    """Name of a device in the catalogue, or the file of that name in `folder`, whatever folder the study states."""
    if in_catalogue(name):  # safety: stored-device
        return name
    plain = PurePath(name.replace("\\", "/")).name
    remedy = f"if you trust it, copy it to {folder.absolute() / plain}"
    if not plain:
        raise InputError(f"device {quote(name)}: is no device of the catalogue and not the name of a file")
    path = named_file(plain, folder, "device file", InputError, remedy=remedy)
    if not path.exists():
        raise InputError(
            f"device {quote(name)} is no device of the catalogue; a device file that a stored study names is read only "
            f"beside the database: {remedy}"
        )
    return str(path)


def _load_world(study: Study, file: WorldFile) -> Study:
    """`study` with the world in `file` and the digest of its code, which is part of the study's identity."""
    with announce_wait(f"World file {file.path} has not returned from loading and its first call"):
        world = try_world(start_world_file(file), study.load_device())
    digest = sha256(read_bytes(file.path, _MAX_WORLD_FILE_BYTES, "world file", InputError)).hexdigest()
    if study.world_digest not in ("", digest):
        raise InputError(f"world_digest is not that of {file.path}: the file has changed; leave out the key")
    found = study if study.world_digest else _add_key(study, "world_digest", digest)
    return found.with_world(world)


def _add_key(study: Study, key: str, value: str) -> Study:
    """`study` with a key that its file does not have; it precedes the file's text in a database."""
    return study.with_text(f'{key} = "{value}"\n{study.text}', {key: value})


# --------------------------------------------------------------------------------------------------
# Interpretation of a study file by older versions: a study continues as it began.


def list_older(study: Study) -> list[Study]:
    """The study as older versions ran this file, newest first: with coils as points, then with their order of trials
    too, then with 1 + 8 + 8 + 8 as published too.

    Empty where the file itself has the keys.
    """
    found, older = [], study
    # The keys precede the file's own text; the digest of a world's file may precede them.
    for key in ("model_version", "order_version", "published_layout"):
        lines, added = older.text.splitlines(keepends=True), f'{key} = "{getattr(older, key)}"\n'
        if not getattr(older, key) or added not in lines[:4]:
            continue
        lines.remove(added)
        update: dict[str, object] = {key: ""}
        if key == "order_version" and "order" not in study.trials.model_fields_set:
            update["trials"] = study.trials.model_copy(update={"order": "random"})
        older = older.with_text("".join(lines), update)
        found.append(older)
    return found
