"""Stepping of one scene: MuJoCo's data structure is scratch memory, filled from a world's memory and read back into it.

All state is in the memory. So the same memory, state and dt give the same step, bit for bit, regardless of earlier
use of this pad.
"""

from __future__ import annotations

import math
import os
import re
from copy import copy
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from haptorb.arrays import Array, Records, fields
from haptorb.compiled import kernel
from haptorb.errors import InputError, UnknownName, quote
from haptorb.file_kind import FileKind, find_kind
from haptorb.worlds.dynamic import MemoryField, MemoryNotFinite
from haptorb.worlds.scene_check import check_scene_file
from haptorb.worlds.scene_compiler import compile_scene

__all__ = [
    "BACKGROUND",
    "COUPLING",
    "LEVELS",
    "PACE_FIELDS",
    "SCENE_TIME",
    "SHIPPED",
    "BackgroundStep",
    "SceneExplosion",
    "SceneModel",
    "ScenePace",
    "SceneStepper",
    "advance_pace",
    "fill_coupling",
    "fill_tank",
    "find_scene_file",
    "fit_to_pace",
    "is_shipped_scene",
    "list_kinds",
    "load_engine",
    "make_scene_model",
    "push",
    "state_size",
    "take_over_step",
]


# --------------------------------------------------------------------------------------------------
# Pace of a scene: ratio of its time to the loop's, reduced while its steps take too long.
#
# The pace changes smoothly. With a sudden change, moving bodies would change their velocity relative to the hand within
# a tick, and the hand would feel an impact. The coupling is softer at a slower pace. If its spring is stretched, an
# increasing pace would add energy to it; so the pace increases only if the coupling's damper has dissipated that energy
# before (an energy tank, as in Ferraguti, Secchi and Fantuzzi 2013).


#: detail → (share of the solver's iterations, pace that the scene approaches). The solver ends at convergence: a lower
#: limit shortens the longest steps only, and far below a half tight contacts oscillate
LEVELS = ((1.0, 1.0), (0.5, 1.0), (0.5, 0.5), (0.5, 0.25), (0.5, 0.125), (0.5, 0.125))
BACKGROUND = len(LEVELS) - 1  #: level of background steps: a single step is longer than a tick
_PACE_TIME_CONSTANT_S = 0.1  #: time in which the pace changes by a factor of e [s]
_TANK_CAPACITY_J = 2e-4  #: capacity of the tank [J]

#: Fields of the memory of a scene.
PACE_FIELDS = (
    MemoryField("detail", "1", "0: full detail; above: fewer iterations, slower time, then background steps"),
    MemoryField("pace", "1", "speed of the scene's time"),
    MemoryField("lighter", "1", "ticks with less than full detail"),
    MemoryField("behind", "s", "delay of the scene's time"),
    MemoryField("due", "1", "fraction of a step due in slow time"),
    MemoryField("stretched", "J", "energy stored in the coupling"),
    MemoryField("tank", "J", "energy that the coupling's damper took in slow time and its spring may use"),
    MemoryField("pending", "1", "1 while a step is computed in the background"),
    MemoryField("share", "N", "wrench on the body during that step: force, and torque [N·m]", (6,)),
    MemoryField("waiting", "N·s", "impulse of the coupling for the next step, linear and angular [N·m·s]", (6,)),
)


class ScenePace(NamedTuple):
    """Pace of a scene in one tick.

    level   of detail, an index of `LEVELS`
    steps   number of steps due now
    pace    ratio of its time to the loop's, 0 to 1
    ahead   fraction of a step by which its time has advanced since the last step
    passed  number of steps by which its time advances now
    """

    level: int
    steps: int
    pace: float
    ahead: float
    passed: float


def advance_pace(one: Any, steps: int, dt: float) -> ScenePace:
    """Advance by one tick of `dt` [s], with `steps` steps [1] at full pace, for a memory with PACE_FIELDS, in their
    units."""
    level, pace = int(one["detail"]), float(one["pace"])
    aim = LEVELS[level][1]
    if not level and pace == 1.0:
        return ScenePace(0, steps, 1.0, 0.0, float(steps))
    glide = math.exp(dt / _PACE_TIME_CONSTANT_S)
    if pace > aim:
        pace = max(aim, pace / glide)
    elif pace < aim:
        pace = _rise(one, pace, min(aim, pace * glide))
    ahead = float(one["due"])
    due = ahead + pace * steps
    count = int(due)
    if level == BACKGROUND:  # its time stops at the end of a step until that has been computed
        due, count = min(due, 1.0), 0
    passed = due - ahead
    one["pace"], one["due"] = pace, due - count if pace < 1.0 or level == BACKGROUND else 0.0
    one["lighter"] += 1.0
    one["behind"] += (1.0 - passed / steps) * dt
    return ScenePace(level, count, pace, ahead, passed)


def take_over_step(one: Any, state: Any) -> None:
    """Accept `state` (n,), in SI units, as the result of the background step of a memory with PACE_FIELDS."""
    one["state"][:] = state
    one["pending"], one["due"] = 0.0, max(float(one["due"]) - 1.0, 0.0)


def _rise(one: Any, pace: float, faster: float) -> float:
    """Next pace: `faster`, if the tank has the energy that this adds to the coupling's spring."""
    needed = float(one["stretched"]) * ((faster / pace) ** 2 - 1.0)  # the stiffness increases at most with the square
    if needed > float(one["tank"]):  # safety: stiffer-from-the-tank
        return pace
    one["tank"] -= needed
    return faster


def fill_tank(one: Any, stretched: float, taken: float) -> None:
    """Record that the coupling stores `stretched` [J] and its damper dissipated `taken` [J] in this tick of slow
    time."""
    one["stretched"] = stretched
    one["tank"] = min(float(one["tank"]) + taken, _TANK_CAPACITY_J)


# --------------------------------------------------------------------------------------------------
# Scene compiled by MuJoCo, from an XML file or from Python, and the messages when it cannot be compiled.


_FOLDER = Path(__file__).parent / "shipped_scenes"
#: scenes supplied with this package
SHIPPED = ("peg", "outlet", "boxes", "drawer")
_MAX_LISTED_NAMES = 8  #: maximum number of names in a message
_MAX_STEPS_PER_TICK = 200  #: in a tick
_LINE = re.compile(r"[Ll]ine(?: number)?\s*=?\s*(\d+)")


@cache
def load_engine() -> Any:
    """Import MuJoCo, set to write no files. Raises InputError with the package to install if it is missing."""
    try:
        import mujoco
    except ImportError as cause:
        raise InputError(f"scenes need MuJoCo: pip install 'haptorb[scenes]' ({cause})") from cause
    # Otherwise it writes MUJOCO_LOG.TXT to the working directory, in the middle of a tick.
    mujoco.set_mju_user_warning(_ignore)
    return mujoco


def _ignore(text: str) -> None:
    """Warning handler without effect: the state is checked instead."""


def find_scene_file(text: str, folder: Path | None = None) -> Path:
    """File named by `text`: a supplied scene, or a path; relative to `folder`, otherwise to the working directory.

    Raises UnknownName for anything else.

    >>> find_scene_file("peg").name
    'peg.xml'
    """
    if text in SHIPPED:
        return _FOLDER / f"{text}.xml"
    place = (folder or Path()) / text
    named = text.lower().endswith(".xml")
    if not named and (other := find_kind(place)) is not None:
        raise InputError(FileKind.SCENE.explain_found(place, other))
    if not named:
        raise UnknownName("scene", text, (*SHIPPED, "FILE.xml"))
    return Path(os.path.abspath((folder or Path()) / Path(text).expanduser()))


def is_shipped_scene(path: Path) -> bool:
    """Whether `path` is the file of a supplied scene.

    >>> is_shipped_scene(find_scene_file("peg")), is_shipped_scene(Path("peg.xml"))
    (True, False)
    """
    return path.parent == _FOLDER and path.suffix == ".xml" and path.stem in SHIPPED


@dataclass(frozen=True)
class SceneModel:
    """Compiled scene; it can be sent to another process.

    title   file name without the extension, or the model's own
    file    source file; None: from Python
    model   MuJoCo's MjModel; only the iterations of its solver are changed here
    """

    title: str
    file: Path | None
    model: Any = field(repr=False, compare=False)
    #: of `SceneStepper`, created once each
    pads: dict[Any, Any] = field(default_factory=dict, repr=False, compare=False)
    remarks: tuple[str, ...] = field(default=(), repr=False, compare=False)  #: changes of the scene, for the user

    def __getstate__(self) -> dict[str, Any]:
        """State without the scratch data, which the receiver creates again."""
        return {"title": self.title, "file": self.file, "model": self.model, "pads": {}, "remarks": self.remarks}

    @property
    def held(self) -> str:
        """Default held body: the one that the file names, otherwise "peg". Raises InputError if there is neither."""
        model = self.model
        for n in range(model.ntext):
            named, first = int(model.name_textadr[n]), int(model.text_adr[n])
            if model.names[named:].split(b"\0", 1)[0] == b"held":
                text = model.text_data[first : first + int(model.text_size[n])]
                return str(bytes(text).split(b"\0", 1)[0].decode())
        if "peg" not in self.bodies:
            movable = [name for name in self.bodies if self.count_freedoms(int(self.model.body(name).id))]
            known = f" ({_list_some(movable)})" if movable else ""
            raise InputError(
                f"scene '{self.title}' does not state which body the device holds: name one{known} with --body, or in "
                'the file with <custom><text name="held" data="BODY"/></custom>'
            )
        return "peg"

    @property
    def bodies(self) -> list[str]:
        """Names of the named bodies, except the world."""
        return [name for i in range(1, self.model.nbody) if (name := self.model.body(i).name)]

    def find_body(self, name: str) -> int:
        """Index [1] of the body `name`. Raises UnknownName with the most similar one of the scene, and InputError
        for one that cannot move."""
        model = self.model
        if name not in self.bodies:
            near = get_close_matches(name[:100], self.bodies, n=_MAX_LISTED_NAMES, cutoff=0.3)
            raise UnknownName(f"body of scene '{self.title}'", name, near or self.bodies[:_MAX_LISTED_NAMES])
        index = int(model.body(name).id)
        if not self.count_freedoms(index):
            raise InputError(
                f"body '{name}' of scene '{self.title}' cannot be moved: neither it nor a body that carries it has a "
                "joint; give it one, such as <freejoint/>, or name another body with --body"
            )
        return index

    def count_freedoms(self, body: int) -> int:
        """Number of degrees of freedom [1] of `body`, from its own joints and those of its parents."""
        model, count = self.model, 0
        while body > 0:
            count += int(model.body_dofnum[body])
            body = int(model.body_parentid[body])
        return count

    def divide_tick(self, period: float) -> tuple[int, float]:
        """Number of steps [1] in a tick of `period` [s], and their length [s]: that of the file, or the next shorter
        one that divides the tick, with which a scene is as stable. Raises InputError for more than 200 steps."""
        step = float(self.model.opt.timestep)
        count = max(round(period / step), 1)
        if abs(count * step - period) > 1e-9:
            count = max(math.ceil(period / step - 1e-9), 1)
            step = period / count
        if count > _MAX_STEPS_PER_TICK:
            raise InputError(
                f"scene '{self.title}': its timestep of {1e3 * step:.3g} ms makes {count} steps in a tick of "
                f"{1e3 * period:g} ms; at most {_MAX_STEPS_PER_TICK} are possible: make it longer"
            )
        return count, step

    def explain_step(self, period: float) -> str:
        """Message about the changed timestep of the scene for ticks of `period` [s]; empty if it is not changed."""
        own, step = float(self.model.opt.timestep), self.divide_tick(period)[1]
        if abs(own - step) <= 1e-9:
            return ""
        return (
            f"scene '{self.title}': its timestep of {1e3 * own:.4g} ms does not divide the tick of "
            f"{1e3 * period:g} ms; {1e3 * step:.4g} ms is used"
        )

    @property
    def controls(self) -> Array:
        """(nu,) constant controls of its actuators: those of the first keyframe, otherwise zero [N, N·m, m or rad]."""
        model = self.model
        return np.array(model.key_ctrl[0] if model.nkey else np.zeros(model.nu), dtype=np.float64)

    @property
    def control_spans(self) -> Array:
        """(nu,) half the range of each control, 1 for one without a range [N, N·m, m or rad]."""
        model = self.model
        limited = np.asarray(model.actuator_ctrllimited, dtype=bool).reshape(-1)
        spans: Array = np.where(limited, 0.5 * (model.actuator_ctrlrange[:, 1] - model.actuator_ctrlrange[:, 0]), 1.0)
        return spans

    @property
    def actuators(self) -> list[str]:
        """Name of each actuator; "actuator 3" for one without a name."""
        return [self.model.actuator(n).name or f"actuator {n + 1}" for n in range(self.model.nu)]


def make_scene_model(source: object, assets: Path | None = None) -> SceneModel:
    """The compiled scene `source`: a supplied scene, the path of an XML file, or an MjModel. assets: the folder within
    which a file may name others; by default its own.

    Raises UnknownName for an unknown name; InputError for a file that cannot be read or compiled, with the line if
    the engine states it, and for a scene without a movable body.
    """
    if isinstance(source, SceneModel):
        return source
    engine = load_engine()
    if isinstance(source, engine.MjModel):
        return _check(SceneModel(source.names.split(b"\0")[0].decode() or "model", None, source))
    if not isinstance(source, str | Path):
        raise InputError(f"a scene is a name, a path of an XML file, or an MjModel of MuJoCo; got {quote(source)}")
    path = find_scene_file(str(source))
    own = path.parent == _FOLDER
    files = {} if own else check_scene_file(path, assets)  # safety: scene-checked
    try:
        model = (
            engine.MjModel.from_xml_path(str(path)) if own else compile_scene(engine, path, files)
        )  # safety: compiled-apart
    except Exception as cause:  # ValueError, FatalError, SceneFailure
        raise InputError(_explain(path, str(cause))) from cause
    return _check(SceneModel(path.stem, path, model))


def _explain(path: Path, text: str) -> str:
    """The engine's message in one line, with the line of the file first."""
    plain = " ".join(text.replace("XML Error:", "").replace("Error:", "").split())
    found = _LINE.search(plain)
    where = f"{path}, line {found.group(1)}" if found else str(path)
    return f"scene {where}: {plain}"


def _check(scene: SceneModel) -> SceneModel:
    model = scene.model
    if model.nv == 0:
        raise InputError(
            f"scene '{scene.title}' has nothing that can be moved: no body has a joint; give the body that is to be "
            "held one, such as <freejoint/>"
        )
    remarks = []
    kinds = load_engine().mjtIntegrator
    # evaluates all forces four times in a step, without the hand's
    if int(model.opt.integrator) == int(kinds.mjINT_RK4):
        model.opt.integrator = int(kinds.mjINT_IMPLICITFAST)
        remarks.append(f"scene '{scene.title}': integrator implicitfast is used instead of RK4")
    if model.nu:
        many = (
            f"1 actuator ({scene.actuators[0]}) holds"
            if model.nu == 1
            else f"{model.nu} actuators ({_list_some(scene.actuators)}) hold"
        )
        controls = "the controls of the first keyframe" if model.nkey else "control 0"
        remarks.append(f"scene '{scene.title}': {many} {controls}; control_1 and so on change them")
    loose = np.flatnonzero((model.body_dofnum > 0) & (model.body_mass <= 0.0) & (model.body_subtreemass <= 0.0))
    if loose.size:
        raise InputError(f"scene '{scene.title}': body '{model.body(int(loose[0])).name}' moves but has no mass")
    return replace(scene, remarks=tuple(remarks))


def _list_some(names: list[str]) -> str:
    """First names, and the number of the others."""
    more = len(names) - _MAX_LISTED_NAMES
    return ", ".join(names[:_MAX_LISTED_NAMES]) + (f" and {more} more" if more > 0 else "")


# --------------------------------------------------------------------------------------------------
# One step of a scene in its own data, so that a background thread may compute it.


def list_kinds(engine: Any) -> int:
    """Persistent part of MuJoCo's data from step to step, as a sum of flags [1]."""
    kinds = engine.mjtState
    return int(kinds.mjSTATE_FULLPHYSICS) | int(kinds.mjSTATE_WARMSTART) | int(kinds.mjSTATE_EQ_ACTIVE)


def push(applied: Array, arm: Array, wrench: Array) -> None:
    """`applied` (6,) becomes the wrench (6,) at a body's origin, transferred by `arm` (3,) [m] to its centre [N,
    N·m]."""
    applied[:] = wrench
    applied[3] += arm[1] * wrench[2] - arm[2] * wrench[1]
    applied[4] += arm[2] * wrench[0] - arm[0] * wrench[2]
    applied[5] += arm[0] * wrench[1] - arm[1] * wrench[0]


@final
class BackgroundStep:
    """Steps `scene` with a wrench on the body of index `body`. Not thread-safe."""

    def __init__(self, scene: SceneModel, body: int) -> None:
        self._engine, self._model, self._body = load_engine(), copy(scene.model), body
        option = self._model.opt
        option.disableflags |= int(self._engine.mjtDisableBit.mjDSBL_AUTORESET)
        option.enableflags |= int(self._engine.mjtEnableBit.mjENBL_ENERGY)
        option.iterations = max(2, round(LEVELS[BACKGROUND][0] * int(option.iterations)))
        self._data = self._engine.MjData(self._model)
        self._kinds = list_kinds(self._engine)

    def compute(self, state: Array, share: Array, controls: Array, length: float) -> Array:
        """(n,) the state one step of `length` [s] after `state` (n,), with the wrench `share` (6,) on the body [N,
        N·m] and the `controls` (nu,) of the actuators."""
        engine, model, data, body = self._engine, self._model, self._data, self._body
        model.opt.timestep = length
        data.ctrl[:] = controls
        engine.mj_setState(model, data, state, self._kinds)
        data.xfrc_applied[body] = 0.0
        engine.mj_step1(model, data)
        push(data.xfrc_applied[body], data.xpos[body] - data.xipos[body], share)
        engine.mj_step2(model, data)
        after = state.copy()
        engine.mj_getState(model, data, after, self._kinds)
        return after


# --------------------------------------------------------------------------------------------------
# Virtual coupling: spring and damper between the mover and a body of a scene, both limited.
#
# After Colgate, Stanley and Brown 1995 and Adams and Hannaford 1999: the hand feels the coupling, not the scene itself,
# so a loop that is stable with the coupling against a wall is stable with any passive scene.
#
# In a scene at pace s, bodies feel 1/s² times as heavy. With the same coupling the damping ratio of the body in it
# would decrease to s times its value, and the body would oscillate. So the damper is increased by 1/s, up to
# `slow_damping`; beyond that the spring is reduced by (s d/b)², where d is the damper instead of b. The damping ratio
# is always that of full speed, and the coupling is never stiffer.


#: Settings of the kernel.
COUPLING = fields(
    ("stiffness", "f8"), ("damping", "f8"), ("greatest", "f8"),  # [N/m], [N·s/m], [N]
    ("turn_stiffness", "f8"), ("turn_damping", "f8"), ("turn_greatest", "f8"),  # [N·m/rad], [N·m·s/rad], [N·m]
    ("slow_damping", "f8"), ("slow_turn_damping", "f8"),  # at a slower pace [N·s/m], [N·m·s/rad]
)  # fmt: skip

#: Time of a scene in a tick.
SCENE_TIME = fields(
    ("pace", "f8"),  # ratio of its time to the loop's, 0 to 1
    ("flow", "f8"),  # the same in this tick alone: 0 while it waits for a step
    ("ahead", "f8"),  # time since the body's last pose [s]
)


@kernel
def fit_to_pace(stiffness: float, damping: float, most: float, pace: float) -> tuple[float, float]:
    """Stiffness and damping while the scene's time passes `pace` times as fast, 0 to 1, with a damper of at most
    `most`; the body keeps its damping ratio.

    >>> fit_to_pace(100.0, 2.0, 8.0, 0.25), fit_to_pace(100.0, 2.0, 4.0, 0.25), fit_to_pace(100.0, 2.0, 0.0, 0.25)
    ((100.0, 8.0), (25.0, 4.0), (6.25, 2.0))
    """
    if pace >= 1.0:
        return stiffness, damping
    damper = max(min(damping / pace, most), damping)
    share = pace * damper / damping if damping > 0.0 else pace
    return share * share * stiffness, damper


@kernel
def _limit(
    spring: Array, stretch: Array, speed: Array, stiffness: float, damping: float, greatest: float
) -> tuple[float, float]:
    """Fill spring (3,) with the force of spring and damper, each at most `greatest`; return the spring's energy [J] and
    the damper's power [W]."""
    length, fast = 0.0, 0.0
    for i in range(3):
        length += stretch[i] * stretch[i]
        fast += speed[i] * speed[i]
    length, fast = np.sqrt(length), np.sqrt(fast)
    pull = stiffness * length
    share = 1.0 if pull <= greatest else greatest / pull
    drag = 1.0 if damping * fast <= greatest else greatest / (damping * fast)
    for i in range(3):
        spring[i] = share * stiffness * stretch[i] + drag * damping * speed[i]
    power = drag * damping * fast * fast
    if share == 1.0:
        return 0.5 * pull * length, power
    most = greatest / stiffness
    return 0.5 * greatest * most + greatest * (length - most), power


@kernel
def _turn_between(R: Array, x: Array, turn: Array) -> None:
    """turn (3,) becomes the rotation vector [rad] from the attitude `x` (9,), by rows, to R (3, 3)."""
    D = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            D[i, j] = R[i, 0] * x[3 * j] + R[i, 1] * x[3 * j + 1] + R[i, 2] * x[3 * j + 2]
    turn[0], turn[1], turn[2] = D[2, 1] - D[1, 2], D[0, 2] - D[2, 0], D[1, 0] - D[0, 1]
    sine = 0.5 * np.sqrt(turn[0] ** 2 + turn[1] ** 2 + turn[2] ** 2)
    angle = np.arctan2(sine, 0.5 * (D[0, 0] + D[1, 1] + D[2, 2] - 1.0))
    factor = 0.5 * angle / sine if sine > 1e-9 else 0.5
    for i in range(3):
        turn[i] *= factor


@kernel
def fill_coupling(
    couplings: Records, pose: Array, R: Array, motion: Array, place: Array, attitude: Array, moving: Array,
    time: Records, wrench: Array,
) -> tuple[float, float]:  # fmt: skip
    """Fill wrench (6,) with the force [N] and torque about the body's origin [N·m] on the body; return the energy of
    the springs [J] and the power that the dampers take [W].

    couplings (1,) COUPLING. Target of the body: pose (3,) [m], R (3, 3), motion (6,) linear and angular. Last
    pose: place (3,), attitude (9,) by rows, moving (6,) angular and linear as MuJoCo has it. `time` (1,) is a
    SCENE_TIME.
    """
    c, t = couplings[0], time[0]
    stretch, speed = np.empty(3), np.empty(3)
    for i in range(3):
        stretch[i] = pose[i] - place[i] - t.ahead * moving[3 + i]
        speed[i] = motion[i] - t.flow * moving[3 + i]
    stiffness, damping = fit_to_pace(c.stiffness, c.damping, c.slow_damping, t.pace)
    energy, power = _limit(wrench[:3], stretch, speed, stiffness, damping, c.greatest)
    if c.turn_stiffness == 0.0:
        wrench[3:] = 0.0
        return energy, power
    _turn_between(R, attitude, stretch)
    for i in range(3):
        stretch[i] -= t.ahead * moving[i]
        speed[i] = motion[3 + i] - t.flow * moving[i]
    stiffness, damping = fit_to_pace(c.turn_stiffness, c.turn_damping, c.slow_turn_damping, t.pace)
    more = _limit(wrench[3:], stretch, speed, stiffness, damping, c.turn_greatest)
    return energy + more[0], power + more[1]


Integers = NDArray[np.int64]

_MAX_COORDINATE = 1e8  #: limit of a coordinate or speed


class SceneExplosion(MemoryNotFinite):
    """State of a scene that is not finite, or exceeds all limits."""


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
    """`scene` with the body of index `body` in the coupling; `drawn` (g,) are the shapes with reported poses."""

    def __init__(self, scene: SceneModel, body: int, drawn: Integers) -> None:
        self._engine, self._scene, self._model = load_engine(), scene, copy(scene.model)
        self._data = self._engine.MjData(self._model)
        self._kinds, self._body, self._drawn = list_kinds(self._engine), body, drawn
        option = self._model.opt
        # A divergence must switch the coils off, not restart the scene in the hand.
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
        self._controls, self._length = scene.controls, float(option.timestep)
        self._background = BackgroundStep(scene, body)

    def set_step(self, length: float, controls: Array) -> None:
        """Set the steps' `length` [s] and the constant `controls` (nu,) of the actuators."""
        if length != self._length:
            self._model.opt.timestep = self._length = length
        self._controls = controls
        self._data.ctrl[:] = controls

    def begin(self) -> tuple[Array, Array, Array, Array, Array]:
        """The initial state (n,), positions (g, 3) [m] and orientations (g, 4) of the drawn shapes, and position
        (3,) and orientation (3, 3) of the body. If the scene has keyframes, the first one is the initial state."""
        engine, model, data = self._engine, self._model, self._data
        if model.nkey:
            engine.mj_resetDataKeyframe(model, data, 0)
        else:
            engine.mj_resetData(model, data)
        data.ctrl[:] = self._controls
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
        self, one: Any, goal: tuple[Array, Array, Array], couplings: Records, time: ScenePace, dt: float
    ) -> tuple[Array, float]:
        """(6,) force and torque on the body in this tick of `dt` [s] [N, N·m], and the energy [J] of scene and coupling
        before it. The fields `state` and `waiting` of the record `one` are advanced.

        goal    target of the body: position (3,) [m], orientation (3, 3), motion (6,) linear and angular

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
            energy = self._wait(one, goal, couplings, time, dt)
        elif time.pace == 1.0:
            energy = self._step(goal, couplings, time.steps)
        else:
            energy = self._step_slowly(one, goal, couplings, time, dt)
        if time.steps:
            engine.mj_getState(model, data, lasting, self._kinds)
        if (time.steps or time.level == BACKGROUND) and not (np.abs(lasting).max() < _MAX_COORDINATE):
            raise SceneExplosion(self._explain())
        return self._total, energy

    def _step(self, goal: tuple[Array, Array, Array], couplings: Records, steps: int) -> float:
        """Take all `steps` of a tick at full pace, each with its own wrench of the coupling."""
        engine, model, data, total = self._engine, self._model, self._data, self._total
        total[:] = 0.0
        energy = 0.0
        for step in range(steps):
            self._pushed[:] = 0.0
            engine.mj_step1(model, data)
            stretched, _ = self._couple(goal, couplings, 1.0, 1.0, 0.0)
            if step == 0:
                energy = stretched + float(data.energy[0]) + float(data.energy[1])
            self._push(self._wrench)
            total += self._wrench
            engine.mj_step2(model, data)
        total /= steps
        return energy

    def _step_slowly(
        self, one: Any, goal: tuple[Array, Array, Array], couplings: Records, time: ScenePace, dt: float
    ) -> float:
        """A tick of slow time, with or without a step: a step applies the whole impulse since the last one, so that
        none of it is lost or counted twice."""
        engine, model, data = self._engine, self._model, self._data
        length = float(model.opt.timestep)
        self._pushed[:] = 0.0
        if time.steps:
            engine.mj_step1(model, data)
        else:
            self._find_motion()
        energy = self._collect_impulse(one, goal, couplings, time, dt)
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
        self, one: Any, goal: tuple[Array, Array, Array], couplings: Records, time: ScenePace, dt: float
    ) -> float:
        """A tick of slow time with its step computed in the background; the next one begins as soon as none is
        pending."""
        self._find_motion()
        energy = self._collect_impulse(one, goal, couplings, time, dt)
        if not one["pending"]:
            np.divide(one["waiting"], float(self._model.opt.timestep), out=self._share)
            one["share"], one["waiting"], one["pending"] = self._share, 0.0, 1.0
        return energy

    def compute_step(self, state: Array, share: Array) -> Array:
        """(n,) the state one step after `state` (n,), with the wrench `share` (6,) on the body [N, N·m]. At the detail
        of background steps, in data of its own: it may run while another thread advances the scene."""
        return self._background.compute(state, share, self._controls, self._length)

    def _find_motion(self) -> None:
        """Update positions and velocities; contacts are not needed."""
        engine, model, data = self._engine, self._model, self._data
        engine.mj_kinematics(model, data)
        engine.mj_comPos(model, data)
        engine.mj_tendon(model, data)
        engine.mj_comVel(model, data)
        engine.mj_energyPos(model, data)
        engine.mj_energyVel(model, data)

    def _collect_impulse(
        self, one: Any, goal: tuple[Array, Array, Array], couplings: Records, time: ScenePace, dt: float
    ) -> float:
        """Present wrench of the coupling, and its impulse for the next step; energy of scene and coupling [J]."""
        length, data, waiting = float(self._model.opt.timestep), self._data, one["waiting"]
        stretched, power = self._couple(goal, couplings, time.pace, time.passed * length / dt, time.ahead * length)
        fill_tank(one, stretched, power * dt)
        self._total[:] = self._wrench
        np.multiply(self._wrench, time.passed * length, out=self._share)
        waiting += self._share
        return stretched + float(data.energy[0]) + float(data.energy[1])

    def _couple(
        self, goal: tuple[Array, Array, Array], couplings: Records, pace: float, flow: float, ahead: float
    ) -> tuple[float, float]:
        """Compute the coupling's wrench on the body; return energy of the springs [J] and power of the dampers [W]."""
        engine, moving, now = self._engine, self._moving, self._time
        now["pace"], now["flow"], now["ahead"] = pace, flow, ahead
        engine.mj_objectVelocity(self._model, self._data, engine.mjtObj.mjOBJ_XBODY, self._body, moving, 0)
        place, R, motion = goal
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
