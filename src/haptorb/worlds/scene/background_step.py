"""One step of a scene in data of its own, so that a background thread may compute it."""

from __future__ import annotations

from copy import copy
from typing import Any, final

from haptorb.numerics.arrays import Array
from haptorb.worlds.scene.pace import BACKGROUND, LEVELS
from haptorb.worlds.scene.scene_model import SceneModel, load_engine

__all__ = ["BackgroundStep", "list_kinds", "push"]


def list_kinds(engine: Any) -> int:
    """What of MuJoCo's data lasts from step to step, as a sum of flags [1]."""
    kinds = engine.mjtState
    return int(kinds.mjSTATE_FULLPHYSICS) | int(kinds.mjSTATE_WARMSTART) | int(kinds.mjSTATE_EQ_ACTIVE)


def push(applied: Array, arm: Array, wrench: Array) -> None:
    """`applied` (6,) becomes the wrench (6,) at a body's origin, moved by `arm` (3,) [m] to its centre [N, N·m]."""
    applied[:] = wrench
    applied[3] += arm[1] * wrench[2] - arm[2] * wrench[1]
    applied[4] += arm[2] * wrench[0] - arm[0] * wrench[2]
    applied[5] += arm[0] * wrench[1] - arm[1] * wrench[0]


@final
class BackgroundStep:
    """Steps `scene` with a wrench on the body of index `body`. Not for two threads at once."""

    def __init__(self, scene: SceneModel, body: int) -> None:
        self._engine, self._model, self._body = load_engine(), copy(scene.model), body
        option = self._model.opt
        option.disableflags |= int(self._engine.mjtDisableBit.mjDSBL_AUTORESET)
        option.enableflags |= int(self._engine.mjtEnableBit.mjENBL_ENERGY)
        option.iterations = max(2, round(LEVELS[BACKGROUND][0] * int(option.iterations)))
        self._data = self._engine.MjData(self._model)
        self._kinds = list_kinds(self._engine)

    def compute(self, state: Array, share: Array) -> Array:
        """(n,) the state one step after `state` (n,), with the wrench `share` (6,) on the body [N, N·m]."""
        engine, model, data, body = self._engine, self._model, self._data, self._body
        engine.mj_setState(model, data, state, self._kinds)
        data.xfrc_applied[body] = 0.0
        engine.mj_step1(model, data)
        push(data.xfrc_applied[body], data.xpos[body] - data.xipos[body], share)
        engine.mj_step2(model, data)
        after = state.copy()
        engine.mj_getState(model, data, after, self._kinds)
        return after
