"""What the tables of a study file must be together: levels for its procedure, and worlds that its device can render."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

from haptorb import worlds
from haptorb.apps.study.model.set_points import SetPoint
from haptorb.apps.study.model.study_parts import Condition, Levels
from haptorb.devices.electromagnet.electromagnet import SphericalElectromagnet
from haptorb.errors import InputError
from haptorb.worlds.own.failure import fit_world
from haptorb.worlds.parameter import check_names, parameters
from haptorb.worlds.world import World

__all__ = ["check_levels", "check_study"]


class _Study(Protocol):
    """What the checks read of a `Study`, whose module imports this one."""

    @property
    def world(self) -> str: ...

    @property
    def procedure(self) -> str: ...

    @property
    def model(self) -> str | None: ...

    @property
    def parameters(self) -> dict[str, Any]: ...

    @property
    def conditions(self) -> Sequence[Condition]: ...

    @property
    def levels(self) -> Levels | None: ...

    @property
    def own_world(self) -> World | None: ...

    @property
    def points(self) -> tuple[SetPoint, ...]: ...

    def load_device(self) -> SphericalElectromagnet: ...

    def make_world(self, condition: str, number: int = 0, level: float | None = None) -> World: ...


def check_levels(study: _Study) -> None:
    """ValueError unless [levels] fit the procedure, one that varies a level."""
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


def check_study(study: _Study) -> None:
    """InputError unless the device can render every condition, level and set-point."""
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
        device.check_tick_model(study.model)
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
