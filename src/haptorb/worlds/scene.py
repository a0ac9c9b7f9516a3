"""Scene as a world: the mover holds one of its bodies through a virtual coupling."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any, final

import numpy as np

from haptorb.arrays import Array, Records
from haptorb.devices.base import Device, State
from haptorb.errors import InputError
from haptorb.worlds.base import Shape, World, parameter
from haptorb.worlds.dynamic import DynamicWorld, MemoryField, WorldWork, make_memory
from haptorb.worlds.scene_check import list_scene_files
from haptorb.worlds.scene_physics import (
    COUPLING,
    LEVELS,
    PACE_FIELDS,
    SceneModel,
    SceneStepper,
    advance_pace,
    find_scene_file,
    load_engine,
    make_scene_model,
    state_size,
    take_over_step,
)

__all__ = ["Scene", "SceneFile", "SceneWork", "describe_scene", "parse_scene_file"]


# --------------------------------------------------------------------------------------------------
# Shapes of a scene for the console: fixed, or moved by rows of the memory.


_MAX_SHAPE_CORNERS = 20_000  #: maximum number of corners of all meshes, so that the page stays fast
_PLANE = (0.1, 0.1, 5e-4)  #: half lengths of the plate displayed for an infinite plane [m]


def describe_scene(scene: SceneModel, body: int, drawn: tuple[int, ...]) -> tuple[Shape, ...]:
    """All visible shapes of `scene`; `drawn` are those whose poses are in the memory, in the order of its rows.

    A shape of `body`, or of its children, is held. Shapes that MuJoCo does not draw by default (groups 3 to 5) are
    left out, and so are meshes beyond 20 000 vertices in total.
    """
    engine, model = load_engine(), scene.model
    data = engine.MjData(model)
    if model.nkey:
        engine.mj_resetDataKeyframe(model, data, 0)
    engine.mj_kinematics(model, data)
    rows = {shape: row for row, shape in enumerate(drawn)}
    found, corners = [], 0
    for n in range(model.ngeom):
        kind, size, points, triangles = _describe(engine, model, n)
        corners += len(points) // 3
        if not kind or int(model.geom_group[n]) > 2 or corners > _MAX_SHAPE_CORNERS:
            continue
        name = model.geom(n).name or f"shape {n}"
        turn = np.zeros(4)
        engine.mju_mat2Quat(turn, data.geom_xmat[n])
        at = (*data.geom_xpos[n].tolist(), *turn[1:].tolist(), float(turn[0]))
        if n in rows:
            role = "held" if _is_carried(model, int(model.geom_bodyid[n]), body) else "moves"
            found.append(Shape(name, kind, size, "place", "attitude", rows[n], at, role, points, triangles))
        else:
            found.append(Shape(name, kind, size, "", "", 0, at, "fixed", points, triangles))
    return tuple(found)


def _is_carried(model: Any, body: int, carrier: int) -> bool:
    while body > 0:
        if body == carrier:
            return True
        body = int(model.body_parentid[body])
    return False


def _describe(engine: Any, model: Any, n: int) -> tuple[str, tuple[float, ...], tuple[float, ...], tuple[int, ...]]:
    """Kind, size, points and corners of shape `n`; an empty kind if it cannot be displayed."""
    kinds, size = engine.mjtGeom, [max(float(x), 1e-6) for x in model.geom_size[n]]
    kind = int(model.geom_type[n])
    if kind == kinds.mjGEOM_MESH:
        mesh = int(model.geom_dataid[n])
        first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
        start, faces = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
        points = model.mesh_vert[first : first + count].ravel().astype(float).round(7)
        corners = model.mesh_face[start : start + faces].ravel()
        return "mesh", (), tuple(points.tolist()), tuple(corners.tolist())
    if kind == kinds.mjGEOM_PLANE:
        half = [size[i] if size[i] > 1e-6 else _PLANE[i] for i in range(2)]
        return "box", (half[0], half[1], _PLANE[2]), (), ()
    known = {
        int(kinds.mjGEOM_SPHERE): ("sphere", 1), int(kinds.mjGEOM_CAPSULE): ("capsule", 2),
        int(kinds.mjGEOM_CYLINDER): ("cylinder", 2), int(kinds.mjGEOM_BOX): ("box", 3),
        int(kinds.mjGEOM_ELLIPSOID): ("ellipsoid", 3),
    }  # fmt: skip
    if kind not in known:
        return "", (), (), ()
    name, count = known[kind]
    return name, tuple(size[:count]), (), ()


# --------------------------------------------------------------------------------------------------
# Step of a scene as background work.


@final
class SceneWork(WorldWork):
    """Step from `state` (n,) with the wrench `share` (6,) on the held body [N, N·m]; copies of both."""

    def __init__(self, pad: SceneStepper, state: Array, share: Array) -> None:
        self._pad, self._state, self._share = pad, state.copy(), share.copy()

    def compute(self) -> Array:
        """(n,) state after the step."""
        return self._pad.compute_step(self._state, self._share)

    def fits(self, memory: Records) -> bool:
        """Whether `memory` (1,) still waits for this step, from this state [m, m/s]."""
        one = memory[0]
        return bool(
            one["pending"] and np.array_equal(one["state"], self._state) and np.array_equal(one["share"], self._share)
        )


@dataclass(frozen=True)
class Scene(DynamicWorld):
    """MuJoCo scene of which the mover, or a motor's object, holds one body through a virtual coupling.

    Needs the extra `haptorb[scenes]`.

    Parameters
    ----------
    source : str, Path or MjModel
        A supplied scene ("peg", "outlet", "boxes", "drawer"), the path of an XML file (MJCF), or a model.
    body : str
        Name of the held body; it, or a parent body, needs a joint. Empty: the one that the file names,
        <custom><text name="held" data="BODY"/></custom>, else "peg".
    anchored : bool
        True: the mover starts at the body's pose in the scene, as a motor's object does.

    Notes
    -----
    The coupling is a spring and a damper between the mover and the origin of the body's frame; for a motor's object it
    also couples the orientation. The hand feels the coupling, so the loop is stable with any passive scene if it is
    stable with the coupling against a wall (Colgate et al. 1995). With stiffness 0 a servo chooses the coupling for its
    rate, latency and hand.

    A tool's position is in the stator frame, in metres, times `scale`. A motor's object begins at zero, at the initial
    pose of the body. The hand feels `scale` times the force, so that power is the same as in the scene.

    Actuators hold the controls of the file's first keyframe, else zero; `control_1` to `control_8` change those of the
    first eight. A timestep that does not divide the tick is shortened, and RK4 is replaced by implicitfast; `remarks`
    reports it.

    Simplified: energy stored in contacts and actuators is not in `energy`; the passivity control therefore damps
    earlier, never later.
    """

    source: Any = field(default="peg", repr=False)
    body: str = ""
    stiffness: float = parameter(0.0, "N/m", 0, 20e3, "stiffness of the coupling; 0: chosen for rate, latency and hand")
    damping: float = parameter(0.0, "N·s/m", 0, 200, "damping of the coupling, if stiffness is given")
    greatest: float = parameter(0.0, "N", 0, 200, "maximum force of the coupling; 0: that of the device")
    turn_stiffness: float = parameter(
        0.0, "N·m/rad", 0, 200, "rotational stiffness of the coupling; 0: chosen, or none"
    )
    turn_damping: float = parameter(0.0, "N·m·s/rad", 0, 10, "rotational damping of the coupling")
    turn_greatest: float = parameter(0.0, "N·m", 0, 20, "maximum torque of the coupling; 0: that of the device")
    slow_damping: float = parameter(0.0, "N·s/m", 0, 2000, "maximum damping while time is slow; 0: no increase")
    slow_turn_damping: float = parameter(0.0, "N·m·s/rad", 0, 100, "maximum rotational damping while time is slow")
    scale: float = parameter(1.0, "1", 0.01, 100, "scale: metres in the scene per metre of the mover")
    control_1: float = parameter(0.0, "1", -1, 1, "change of actuator 1's control, as a share of half its range")
    control_2: float = parameter(0.0, "1", -1, 1, "change of actuator 2's control")
    control_3: float = parameter(0.0, "1", -1, 1, "change of actuator 3's control")
    control_4: float = parameter(0.0, "1", -1, 1, "change of actuator 4's control")
    control_5: float = parameter(0.0, "1", -1, 1, "change of actuator 5's control")
    control_6: float = parameter(0.0, "1", -1, 1, "change of actuator 6's control")
    control_7: float = parameter(0.0, "1", -1, 1, "change of actuator 7's control")
    control_8: float = parameter(0.0, "1", -1, 1, "change of actuator 8's control")
    anchored: bool = False  #: the mover begins at the body's pose in the scene: a motor's object

    def __post_init__(self) -> None:
        World.__post_init__(self)
        object.__setattr__(self, "source", make_scene_model(self.source))
        object.__setattr__(self, "body", self.body or self.source.held)
        object.__setattr__(self, "_index", self.source.find_body(self.body))

    def __getstate__(self) -> dict[str, Any]:
        """State without the scratch data, which the receiver creates again."""
        return {one.name: getattr(self, one.name) for one in fields(self)} | {"_index": self._index}

    _index: int = field(default=0, init=False, repr=False, compare=False)

    @property
    def model(self) -> SceneModel:
        """The compiled scene."""
        found: SceneModel = self.source
        return found

    @property
    def name(self) -> str:
        """`scene-peg` for peg.xml."""
        return f"scene-{self.model.title}"

    @property
    def remarks(self) -> tuple[str, ...]:
        """Changes of the scene that haptic rendering needed."""
        return self.model.remarks

    def list_remarks(self, period: float) -> tuple[str, ...]:
        """The same for ticks of `period` [s]: also a timestep that does not divide them."""
        step = self.model.explain_step(period)
        return (*self.remarks, step) if step else self.remarks

    @property
    def unused_parameters(self) -> frozenset[str]:
        """Parameters without effect in this scene: controls of actuators that it does not have."""
        return frozenset(_CONTROLS[self.model.model.nu :])

    @property
    def bound(self) -> float:
        """Spring and damper at their maximum [N]."""
        return 2.0 * self.greatest * self.scale if self.greatest else float("inf")

    def for_device(self, device: Device) -> Scene:
        """With the limits of `device`, and the coupling in six degrees of freedom for one with an object."""
        moves_object, limits = bool(device.kind.modes), device.limits
        stiffness, damping = (self.stiffness, self.damping) if self.stiffness else UNCHOSEN[moves_object][:2]
        turn, turn_damping = self.turn_stiffness, self.turn_damping
        if moves_object and not turn:
            turn, turn_damping = UNCHOSEN[moves_object][2:]
        return replace(
            self, stiffness=stiffness, damping=damping, turn_stiffness=turn, turn_damping=turn_damping,
            greatest=self.greatest or (_OBJECT_FORCE if moves_object else limits.force / self.scale),
            turn_greatest=self.turn_greatest or (_OBJECT_TORQUE if moves_object else max(limits.torque, 1e-3)),
            anchored=moves_object,
        )  # fmt: skip

    @cached_property
    def drawn(self) -> tuple[int, ...]:
        """Indices [1] of the moving shapes."""
        model = self.model.model
        return tuple(n for n in range(model.ngeom) if self.model.count_freedoms(int(model.geom_bodyid[n])))

    @cached_property
    def memory_fields(self) -> tuple[MemoryField, ...]:
        """Poses of the drawn bodies, energy, detail, and the state of the engine."""
        count = max(len(self.drawn), 1)
        return (
            MemoryField("place", "m", "position of each moving shape, scene frame", (count, 3)),
            MemoryField("attitude", "1", "orientation of each moving shape, quaternion (x, y, z, w)", (count, 4)),
            MemoryField("energy", "J", "energy: kinetic, potential, in springs and in the coupling"),
            *PACE_FIELDS,
            MemoryField(
                "state", "SI", "state of MuJoCo: time, positions, velocities, warm start", (state_size(self.model),)
            ),
        )

    @cached_property
    def _pad(self) -> SceneStepper:
        # one for all worlds of a scene: creating it could take several ticks, and it is stateless.
        pads = self.model.pads
        if self._index not in pads:
            pads[self._index] = SceneStepper(self.model, self._index, np.array(self.drawn, dtype=np.int64))
        found: SceneStepper = pads[self._index]
        return found

    @cached_property
    def effective_inertia(self) -> tuple[float, float]:
        """The smallest effective mass [kg] and moment of inertia [kg·m²] of the body at its frame's origin, in the
        initial state without contact; at most 1e6 each."""
        return self._pad.effective_inertia()

    @cached_property
    def _couplings(self) -> Records:
        made = np.zeros(1, dtype=COUPLING)
        for name in COUPLING.names or ():
            made[name] = getattr(self, name)
        return made

    @cached_property
    def _beginning(self) -> tuple[Records, Array, Array]:
        """Memory, and position and attitude of the body, at the start."""
        memory = make_memory(self.memory_fields)
        state, places, turns, place, attitude = self._pad.begin()
        memory["state"][0], memory["pace"] = state, 1.0
        if len(places):
            memory["place"][0], memory["attitude"][0] = places, turns
        return memory, place, attitude

    @cached_property
    def _goal(self) -> tuple[Array, Array, Array]:
        return np.zeros(3), np.eye(3), np.zeros(6)

    @cached_property
    def shapes(self) -> tuple[Shape, ...]:
        """All bodies of the scene, moving or fixed."""
        return describe_scene(self.model, self._index, self.drawn)

    def begin(self) -> Records:
        """Initial state of the file, or its first keyframe [m, m/s]."""
        return self._beginning[0].copy()

    def advance(self, memory: Records, state: State, dt: float) -> Array:
        """(6,) wrench of the coupling on the mover [N, N·m], while the scene advances by `dt` [s]."""
        one, pad, goal = memory[0], self._pad, self._goal
        place, R, motion = goal
        np.multiply(state.p, self.scale, out=place)
        np.multiply(state.v, self.scale, out=motion[:3])
        motion[3:] = state.w
        if self.anchored:
            _, beginning, attitude = self._beginning
            place += beginning
            np.matmul(state.R_SR, attitude, out=R)
        else:
            R[:] = state.R_SR
        count, length = self._divide_tick(dt)
        pad.set_step(length, self._controls)
        time = advance_pace(one, count, dt)
        wrench, energy = pad.advance(one, goal, self._couplings, time, dt)
        one["energy"] = energy
        if self.drawn:
            pad.fill_poses(one["place"], one["attitude"])
        rendered = np.negative(wrench)
        rendered[:3] *= self.scale
        return rendered

    def _divide_tick(self, dt: float) -> tuple[int, float]:
        if dt not in self._divided:
            self._divided[dt] = self.model.divide_tick(dt)
        return self._divided[dt]

    @cached_property
    def _divided(self) -> dict[float, tuple[int, float]]:
        return {}

    @cached_property
    def _controls(self) -> Array:
        """(nu,) constant controls of the actuators, in their units."""
        controls, spans = self.model.controls, self.model.control_spans
        for n, name in enumerate(_CONTROLS[: len(controls)]):
            controls[n] += getattr(self, name) * spans[n]
        controls.setflags(write=False)
        return controls

    def check_period(self, dt: float) -> None:
        """Raise InputError if the scene cannot be advanced in ticks of `dt` [s]."""
        self._divide_tick(dt)

    def lighten(self, memory: Records) -> None:
        """A step took too long: reduce the solver's iterations, then slow down time, then compute background steps
        [1]."""
        memory["detail"] = min(float(memory["detail"][0]) + 1.0, len(LEVELS) - 1.0)

    def find_work(self, memory: Records) -> WorldWork | None:
        """Step to be computed in the background, for a scene whose single steps are longer than a tick [1]."""
        one = memory[0]
        return SceneWork(self._pad, one["state"], one["share"]) if one["pending"] else None

    def is_work_due(self, memory: Records) -> bool:
        """Whether the scene's time [1] has reached the end of that step."""
        return bool(memory["pending"][0]) and float(memory["due"][0]) >= 1.0

    def take_over(self, memory: Records, result: Any) -> None:
        """Accept the state `result` (n,) [m, m/s] at the end of the step."""
        take_over_step(memory[0], result)

    def restore(self, memory: Records) -> None:
        """Time is sufficient again: restore one level of detail [1]."""
        memory["detail"] = max(float(memory["detail"][0]) - 1.0, 0.0)

    def keep(self, memory: Records, previous: DynamicWorld, old: Records) -> None:
        """The scene continues [m, m/s] if it is the same one; a file that was saved again restarts."""
        if isinstance(previous, Scene) and previous.source is self.source and old.dtype == memory.dtype:
            memory[:] = old


_CONTROLS = tuple(f"control_{n}" for n in range(1, 9))  #: parameters for the controls of the first actuators
#: with an object or not: default stiffness, damping, and both about each axis: well within the stability limit of
#: every loop at 1 kHz with a light hand
UNCHOSEN = {False: (150.0, 1.0, 0.0, 0.0), True: (1000.0, 5.0, 0.5, 0.005)}
_OBJECT_FORCE, _OBJECT_TORQUE = 60.0, 2.0  #: limits on the wrench on an object [N, N·m]; the guard limits it further


# --------------------------------------------------------------------------------------------------
# Scene in a user's XML file, reloaded whenever it or a file that it names is saved.


def parse_scene_file(text: str, body: str = "", folder: Path | None = None, assets: Path | None = None) -> SceneFile:
    """File of the scene `text`, supplied or a path; relative to `folder`, otherwise to the working directory.

    assets  folder within which it may name files; by default its own

    Raises UnknownName for anything else.
    """
    path = find_scene_file(text, folder)
    if assets is not None and not path.resolve().is_relative_to(assets.resolve()):
        raise InputError(f"--assets {assets} must be a folder above the scene {path}")
    return SceneFile(path, body, assets=assets)


@dataclass(frozen=True)
class SceneFile:
    """Scene in the XML file `path`, whose `body` is held, with `values` for some of its parameters."""

    path: Path
    body: str = ""
    values: Mapping[str, Any] = field(default_factory=dict)
    assets: Path | None = None  #: folder within which it may name files; None: its own
    _watched: dict[Path, tuple[int, int, int] | None] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    def load(self) -> Scene:
        """Compile the file and return its world. Raises UnknownName and InputError as `Scene` does."""
        scene = Scene(make_scene_model(self.path, self.assets), self.body)
        return scene.replace(**self.values) if self.values else scene

    @property
    def stamp(self) -> tuple[tuple[str, tuple[int, int, int] | None], ...] | None:
        """Changes when the file or one that it names is saved, directly or through others: included scenes, meshes,
        textures. Path, and time [ns], size, inode of each, None for one that is missing; None without the scene."""
        now = {path: _stamp(path) for path in self._watched or (self.path,)}
        if now != self._watched:  # other files may be named now
            now = {path: _stamp(path) for path in list_scene_files(self.path, self.assets)}
            self._watched.clear()
            self._watched.update(now)
        if now.get(self.path) is None:
            return None
        return tuple((str(path), found) for path, found in now.items())


def _stamp(path: Path) -> tuple[int, int, int] | None:
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_size, found.st_ino
