"""Stepping of one scene: MuJoCo's own data are a scratch pad, filled from a memory and read back into it.

All state is in the memory. So the same memory, state and dt give the same step, bit for bit, regardless of earlier
use of this pad.
"""

from __future__ import annotations

from copy import copy
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from haptorb.numerics.arrays import Array, Records
from haptorb.numerics.compiled import kernel
from haptorb.worlds.bound_world import MemoryNotFinite
from haptorb.worlds.scene.background_step import BackgroundStep, list_kinds, push
from haptorb.worlds.scene.coupling import SCENE_TIME, fill_coupling
from haptorb.worlds.scene.pace import BACKGROUND, LEVELS, ScenePace, fill_tank, take_over_step
from haptorb.worlds.scene.scene_model import SceneModel, load_engine

Integers = NDArray[np.int64]

__all__ = ["SceneExplosion", "SceneStepper", "state_size"]

_HUGE = 1e8  #: beyond it a coordinate or speed has no meaning


class SceneExplosion(MemoryNotFinite):
    """The state of a scene is not finite, or exceeds all bounds."""


def state_size(scene: SceneModel) -> int:
    """Number of elements [1] of the state of `scene`."""
    engine = load_engine()
    return int(engine.mj_stateSize(scene.model, list_kinds(engine)))


@kernel
def _copy_poses(
    drawn: Integers, bodies: Integers, points: Array, held: Array, own: Array, places: Array, turns: Array
) -> None:
    """Of the shapes `drawn` (g,): places (g, 3) from points (n, 3), and turns (g, 4), scalar last, from the attitudes
    `held` of their bodies and their `own` in those, both (…, 4) and scalar first."""
    for row in range(drawn.size):
        shape = drawn[row]
        for i in range(3):
            places[row, i] = points[shape, i]
        a, b, q = held[bodies[shape]], own[shape], turns[row]
        q[3] = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3]
        q[0] = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2]
        q[1] = a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1]
        q[2] = a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0]


@final
class SceneStepper:
    """`scene` with the body of index `body` in the coupling; `drawn` (g,) are the shapes whose poses are reported."""

    def __init__(self, scene: SceneModel, body: int, drawn: Integers) -> None:
        self._engine, self._scene, self._model = load_engine(), scene, copy(scene.model)
        self._data = self._engine.MjData(self._model)
        self._kinds, self._body, self._drawn = list_kinds(self._engine), body, drawn
        option = self._model.opt
        # A divergence must end with the coils off, not in a scene that restarts by itself in the hand.
        option.disableflags |= int(self._engine.mjtDisableBit.mjDSBL_AUTORESET)
        option.enableflags |= int(self._engine.mjtEnableBit.mjENBL_ENERGY)
        self._iterations = int(option.iterations)
        data = self._data
        self._place, self._attitude = data.xpos[body], data.xmat[body]
        self._centre, self._pushed = data.xipos[body], data.xfrc_applied[body]
        self._time: Records = np.zeros(1, SCENE_TIME)
        self._moving, self._wrench, self._total, self._share = (np.zeros(6) for _ in range(4))
        self._points, self._turns = data.geom_xpos, data.xquat
        self._bodies, self._own = self._model.geom_bodyid.astype(np.int64), self._model.geom_quat
        self._state = np.zeros(state_size(scene))
        self._level = -1
        self._background = BackgroundStep(scene, body)

    def begin(self) -> tuple[Array, Array, Array, Array, Array]:
        """The initial state (n,), positions (g, 3) [m] and orientations (g, 4) of the drawn shapes, and position
        (3,) and orientation (3, 3) of the body. If the scene has keyframes, the first one is the initial state."""
        engine, model, data = self._engine, self._model, self._data
        if model.nkey:
            engine.mj_resetDataKeyframe(model, data, 0)
        else:
            engine.mj_resetData(model, data)
        engine.mj_forward(model, data)
        engine.mj_getState(model, data, self._state, self._kinds)
        places, turns = np.zeros((len(self._drawn), 3)), np.zeros((len(self._drawn), 4))
        self.fill_poses(places, turns)
        return self._state.copy(), places, turns, self._place.copy(), self._attitude.reshape(3, 3).copy()

    def effective_inertia(self) -> tuple[float, float]:
        """Smallest effective mass [kg] and moment of inertia [kg·m²] of the body at its origin, in the initial state:
        from J M⁻¹ Jᵀ."""
        engine, model, data = self._engine, self._model, self._data
        self.begin()
        move, turn = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        engine.mj_jac(model, data, move, turn, self._place, self._body)
        inverse = np.zeros((3, model.nv))
        found = []
        for jacobian in (move, turn):
            engine.mj_solveM(model, data, inverse, jacobian)
            most = float(np.linalg.eigvalsh(jacobian @ inverse.T)[-1])
            found.append(1.0 / max(most, 1e-6))
        return found[0], found[1]

    def advance(
        self, one: Any, wish: tuple[Array, Array, Array], couplings: Records, time: ScenePace, dt: float
    ) -> tuple[Array, float]:
        """(6,) force and torque on the body in this tick of `dt` [s] [N, N·m], and the energy [J] of scene and coupling
        before it. The fields `state` and `waiting` of the record `one` are advanced.

        wish    target of the body: position (3,) [m], orientation (3, 3), motion (6,) linear and angular

        Raises SceneExplosion.
        """
        engine, model, data = self._engine, self._model, self._data
        lasting = one["state"]
        if time.level != self._level:
            self._choose_detail(time.level)
        if one["pending"] and time.level != BACKGROUND:
            take_over_step(one, self.compute_step(lasting, one["share"]))
        engine.mj_setState(model, data, lasting, self._kinds)
        if time.level == BACKGROUND:
            energy = self._wait(one, wish, couplings, time, dt)
        elif time.pace == 1.0:
            energy = self._step(wish, couplings, time.steps)
        else:
            energy = self._step_slowly(one, wish, couplings, time, dt)
        if time.steps:
            engine.mj_getState(model, data, lasting, self._kinds)
        if (time.steps or time.level == BACKGROUND) and not (np.abs(lasting).max() < _HUGE):
            raise SceneExplosion(self._explain())
        return self._total, energy

    def _step(self, wish: tuple[Array, Array, Array], couplings: Records, steps: int) -> float:
        """All `steps` of a tick at full pace, each with its own wrench of the coupling."""
        engine, model, data, total = self._engine, self._model, self._data, self._total
        total[:] = 0.0
        energy = 0.0
        for step in range(steps):
            self._pushed[:] = 0.0
            engine.mj_step1(model, data)
            stretched, _ = self._couple(wish, couplings, 1.0, 1.0, 0.0)
            if step == 0:
                energy = stretched + float(data.energy[0]) + float(data.energy[1])
            self._push(self._wrench)
            total += self._wrench
            engine.mj_step2(model, data)
        total /= steps
        return energy

    def _step_slowly(
        self, one: Any, wish: tuple[Array, Array, Array], couplings: Records, time: ScenePace, dt: float
    ) -> float:
        """A tick of slow time, with or without a step: a step takes the whole impulse since the last one, so that
        nothing of it is lost or counted twice."""
        engine, model, data = self._engine, self._model, self._data
        length = float(model.opt.timestep)
        self._pushed[:] = 0.0
        if time.steps:
            engine.mj_step1(model, data)
        else:
            self._find_motion()
        energy = self._collect_impulse(one, wish, couplings, time, dt)
        waiting: Array = one["waiting"]
        if time.steps:
            np.divide(waiting, time.steps * length, out=self._share)
            waiting[:] = 0.0
            for step in range(time.steps):
                if step:
                    self._pushed[:] = 0.0
                    engine.mj_step1(model, data)
                self._push(self._share)
                engine.mj_step2(model, data)
        return energy

    def _wait(
        self, one: Any, wish: tuple[Array, Array, Array], couplings: Records, time: ScenePace, dt: float
    ) -> float:
        """A tick of slow time whose step is computed in the background; the next one begins as soon as none is."""
        self._find_motion()
        energy = self._collect_impulse(one, wish, couplings, time, dt)
        if not one["pending"]:
            np.divide(one["waiting"], float(self._model.opt.timestep), out=self._share)
            one["share"], one["waiting"], one["pending"] = self._share, 0.0, 1.0
        return energy

    def compute_step(self, state: Array, share: Array) -> Array:
        """(n,) the state one step after `state` (n,), with the wrench `share` (6,) on the body [N, N·m]. At the detail
        of background steps, in data of its own: it may run while another thread advances the scene."""
        return self._background.compute(state, share)

    def _find_motion(self) -> None:
        """Positions and velocities; contacts are not needed."""
        engine, model, data = self._engine, self._model, self._data
        engine.mj_kinematics(model, data)
        engine.mj_comPos(model, data)
        engine.mj_tendon(model, data)
        engine.mj_comVel(model, data)
        engine.mj_energyPos(model, data)
        engine.mj_energyVel(model, data)

    def _collect_impulse(
        self, one: Any, wish: tuple[Array, Array, Array], couplings: Records, time: ScenePace, dt: float
    ) -> float:
        """The coupling's wrench now, and its impulse for the next step; energy of scene and coupling [J]."""
        length, data, waiting = float(self._model.opt.timestep), self._data, one["waiting"]
        stretched, power = self._couple(wish, couplings, time.pace, time.passed * length / dt, time.ahead * length)
        fill_tank(one, stretched, power * dt)
        self._total[:] = self._wrench
        np.multiply(self._wrench, time.passed * length, out=self._share)
        waiting += self._share
        return stretched + float(data.energy[0]) + float(data.energy[1])

    def _couple(
        self, wish: tuple[Array, Array, Array], couplings: Records, pace: float, flow: float, ahead: float
    ) -> tuple[float, float]:
        """Compute the coupling's wrench on the body; return energy of the springs [J] and power of the dampers [W]."""
        engine, moving, now = self._engine, self._moving, self._time
        now["pace"], now["flow"], now["ahead"] = pace, flow, ahead
        engine.mj_objectVelocity(self._model, self._data, engine.mjtObj.mjOBJ_XBODY, self._body, moving, 0)
        place, R, motion = wish
        energy, power = fill_coupling(
            couplings, place, R, motion, self._place, self._attitude, moving, now, self._wrench
        )
        return float(energy), float(power)

    def _push(self, wrench: Array) -> None:
        """Apply `wrench` (6,) to the body, at its origin [N, N·m]."""
        push(self._pushed, self._place - self._centre, wrench)

    def _choose_detail(self, level: int) -> None:
        share, option = LEVELS[level][0], self._model.opt
        option.iterations = max(2, round(share * self._iterations))
        self._level = level

    def fill_poses(self, places: Array, turns: Array) -> None:
        """places (g, 3) [m] and turns (g, 4), quaternions (x, y, z, w), become those of the drawn shapes, at the
        beginning of the last step."""
        _copy_poses(self._drawn, self._bodies, self._points, self._turns, self._own, places, turns)

    def _explain(self) -> str:
        model, data = self._model, self._data
        fastest = np.abs(np.nan_to_num(data.qvel, nan=np.inf, posinf=np.inf, neginf=np.inf)).argmax()
        name = model.body(int(model.dof_bodyid[int(fastest)])).name or "without a name"
        return (
            f"the scene diverged: position or velocity of body '{name}' is not finite or far too large after "
            f"{float(data.time):.3g} s of its time; make its timestep shorter, its contacts softer (solref), or its "
            "bodies heavier"
        )
