"""Simulation of a coil array with its tool and a hand, behind the driver interface.

The array is a random specimen within the tolerances of its file (`coil_array_specimen`), unknown to the controller. Its
coils have inductance and warm up, the moving tool induces a voltage in them, and sensors are noisy. Neglected: mutual
inductance between coils, eddy currents, the core's remanence.
"""

from __future__ import annotations

from typing import final

import numpy as np
from numpy.typing import ArrayLike

from haptorb.arrays import Array, Records, check_finite, fields, vectors
from haptorb.compiled import kernel
from haptorb.devices.base import State
from haptorb.devices.coil_array import CoilArray
from haptorb.errors import DriverError, InputError
from haptorb.estimation.types import Pose, Sample
from haptorb.simulation.base import CoilSimulation
from haptorb.simulation.coil_array_specimen import (
    ArrayTruth,
    draw_coils,
    draw_strength,
    fill_array_truth,
    make_array_truth,
)
from haptorb.simulation.coil_circuits import coil_step, cold_coils
from haptorb.simulation.noise_generator import seed_noise
from haptorb.simulation.surface_contact import contact, plate_contact
from haptorb.simulation.tool_dynamics import (
    TOOL,
    fill_remaining_rotation,
    fill_tool,
    matrix,
    move,
    read_tool,
    set_goal,
)
from haptorb.simulation.wrench_map_extrapolation import find_share, is_elsewhere

__all__ = ["COIL_ARRAY", "SimulatedCoilArray", "advance_array"]


# --------------------------------------------------------------------------------------------------
# Physics of a coil array in compiled code: steps of coils, core, tool, surface and hand.
#
# The map of a hundred coils takes as long as the rest of a tick. So it is computed at most once a millisecond, and
# extrapolated in between (`parts.find_share`). A loop that catches up several missed ticks in one call gets one map for
# them, or it would miss the next ones, too.


_MIN_MAP_STEPS = 4  #: minimum number of steps between two maps …
_COILS_PER_EXTRA_STEP = 32  #: … and in one call one map, plus one more per so many steps and coils

#: State of a simulated coil array except its coils and its map.
COIL_ARRAY = fields(
    ("tool", TOOL),
    ("plate", "?"),  # the surface is a plate, not a dome
    ("dt", "f8"),  # of a step [s]
    ("steps", "i8"),  # in one call
    ("heat", "f8", (2, 3)),  # `TwoNode.step` of a step
    ("wrench", "f8", (6,)),  # of coils and core on the tool, mean of the last call [N, N·m]
    ("depth", "f8"),  # deflection of the surface under the tool [m]
    ("age", "i8"),  # of the newest map [steps]
)


@kernel
def _renew(magnetics: ArrayTruth, R: Array, p: Array, newest: Array, change: Array) -> None:
    """Write the map at R (3, 3) and p (3,) [m] into `newest` (11, w), and its change into `change` (11, w)."""
    count = magnetics.centres.shape[0]
    pose, passive, matrix = np.empty((4, 3)), np.empty(6), np.empty((6, count))
    pose[:3], pose[3] = R, p
    fill_array_truth(magnetics, pose, matrix, passive)
    change[:] = -newest
    newest[:4, :3], newest[4, :6], newest[5:, :count] = pose, passive, matrix
    change += newest
    if not np.isfinite(change[3, 0]):  # the first map
        change[:] = 0.0


@kernel
def advance_array(
    array: Records, coils: Records, duties: Array, goal_p: Array, goal_q: Array, magnetics: ArrayTruth, held: Array
) -> None:
    """Advance `array` (1,) COIL_ARRAY and `coils` (m,) COIL by several steps of coils, core, tool, surface and hand.

    duties (m,); the hand moves to goal_p (3,) [m] and goal_q (4,) if they are valid, else to its last goal; held
    (2, 11, max(m, 6)): pose (4), passive (1) and matrix (6, m) of the newest map, and their change since the previous
    one.
    """
    e = array[0]
    tool, truth, dt, count = e.tool, e.wrench, e.dt, coils.size
    set_goal(tool, goal_p, goal_q)
    R, turn = np.empty((3, 3)), np.empty(3)
    given, total, per_current = np.empty(6), np.empty(6), np.empty((6, count))
    newest, change = held[0], held[1]
    for k in range(count):
        coils[k].duty = duties[k]
    truth[:] = 0.0
    left = 1 + e.steps // _COILS_PER_EXTRA_STEP
    for _ in range(e.steps):
        matrix(tool.q[:], R)
        e.age += 1
        if left > 0 and e.age >= _MIN_MAP_STEPS and is_elsewhere(newest, R, tool.p):
            _renew(magnetics, R, tool.p, newest, change)
            e.age = 0
            left -= 1
        share = find_share(newest, change, R, tool.p)
        for i in range(6):
            given[i] = newest[4, i] + share * change[4, i]
            for k in range(count):
                per_current[i, k] = newest[5 + i, k] + share * change[5 + i, k]
        for k in range(count):  # the power that leaves the coil's circuit equals the power delivered to the tool
            emf = 0.0
            for i in range(3):
                emf += per_current[i, k] * tool.v[i] + per_current[3 + i, k] * tool.w[i]
            coils[k].emf = emf
        coil_step(coils, e.heat, dt)
        for i in range(6):
            for k in range(count):
                given[i] += per_current[i, k] * coils[k].mean
            truth[i] += given[i] / e.steps
            total[i] = given[i]
        e.depth = plate_contact(tool, R, dt, total) if e.plate else contact(tool, R, dt, total)
        fill_remaining_rotation(tool.q, tool.goal_q, turn)
        move(tool, R, turn, total, dt)


_STEP_S = 2.5e-4  #: of the simulation [s]
_INITIAL_MAP_AGE = 1_000_000  #: initial age, so that the map is computed at the first step [steps]


@final
class SimulatedCoilArray(CoilSimulation):
    """Simulation of coils, core, tool, surface and hand of `device`.

    specimen: number of the specimen, from 0: seed of its coils and magnets; None: `seed`. held=False: no hand, and
    gravity acts on the tool. With a hand, the hand carries the tool's weight.

    >>> from haptorb.devices.loader import load
    >>> simulated = SimulatedCoilArray(load("tetrahedron"), seed=1)
    >>> for _ in range(20):
    ...     simulated.advance(1e-3, np.zeros(4), np.array([0, 0, 0.06]), np.array([0, 0, 0, 1.0]))
    >>> bool(-13e-3 < simulated.wrench_actual()[2] < -11.5e-3)      # currents off: the core attracts the tool
    True
    """

    def __init__(self, device: CoilArray, seed: int = 0, *, held: bool = True, specimen: int | None = None) -> None:
        self.device: CoilArray = device
        number = seed if specimen is None else specimen
        seed_noise(number)  # rejects an invalid specimen number
        self._magnetics = make_array_truth(device, draw_coils(device, number), draw_strength(device, number))
        super().__init__(np.zeros(1, dtype=COIL_ARRAY), cold_coils(device), _STEP_S, device.supply.duty_bits)
        self._wrench: Array = self._state["wrench"][0]
        self._tool = self._state["tool"]
        surface = device.surface
        fill_tool(self._tool, device.tool, device.hand if held else None, surface.contact)
        self._tool["tail"], self._tool["dome"]["radius"] = device.tool.reach, surface.dome_radius or surface.height
        self._state["plate"] = not surface.is_dome
        self.reset(seed)

    def reset(self, seed: int = 0) -> None:
        """Reset: cold coils without currents, the tool at rest above the surface, noise from `seed`."""
        self._noise = np.random.default_rng(seed)
        self._coils = cold_coils(self.device)
        self._state["wrench"] = self._state["depth"] = 0.0
        self._held = np.full((2, 11, max(self.device.channels, 6)), np.nan)
        self._t = 0.0
        self.place(self.device.rest_position, (0.0, 0.0, 0.0, 1.0))

    def place(self, p: ArrayLike, q: ArrayLike) -> None:
        """Place the tool at `p` (3,) [m] with quaternion `q` (4,), at rest; below the surface it is raised to contact.

        Raises InputError for an invalid position or quaternion.
        """
        at, turned = vectors(p, "p"), check_finite(q, "q")
        if at.shape != (3,) or turned.shape != (4,) or not turned.any():
            raise InputError(f"p must be a position, shape (3,), q a quaternion, shape (4,); got {p!r}, {q!r}")
        tool, contact = self._tool, self.device.contact_height
        tool["p"] = lift(at, contact, self.device.surface.is_dome)
        tool["q"] = turned / np.linalg.norm(turned)
        tool["v"] = tool["w"] = 0.0
        tool["goal"], tool["goal_q"] = at, tool["q"]
        self._state["age"] = _INITIAL_MAP_AGE

    def _fill_heat(self, dt: float) -> None:
        self._state["heat"] = self.device.coils.heat.coil.step(dt)

    def advance(self, dt: float, duties: Array, goal_p: Array, goal_q: Array) -> None:
        """Advance by `dt` [s]; a goal that is not finite leaves the hand's last one.

        Raises InputError for less than 0 or more than 10 s.
        """
        if self._set_steps(dt):
            advance_array(self._state, self._coils, duties, goal_p, goal_q, self._magnetics, self._held)
            self._t += dt

    def sample(self, t: float, pose_stamp: float, pose_valid: bool) -> Sample:
        """Read every sensor once, with the tool's true pose as the tracker's output.

        Raises DriverError if the simulated state is not finite.
        """
        device, coils, state = self.device, self._coils, self.state()
        if not np.isfinite(state.p @ state.p + state.v @ state.v + state.w @ state.w):
            raise DriverError(
                "the simulated tool's state is not finite: a value of the device file is unrealistic; "
                "compare tool, hand and contact with the file of 'tetrahedron'"
            )
        noise = self._noise.standard_normal((2, device.channels))
        current = quantise_reading(
            coils["current"] + device.supply.current_noise * noise[0], device.supply.current_step
        )
        warmth = quantise_reading(coils["body"] + device.thermometer_noise * noise[1], device.thermometer_step)
        pose = Pose(pose_stamp, state.R_SR, state.p, state.w, state.v, pose_valid)
        return Sample(t, current, warmth, np.empty((0, 3)), pose)

    def wrench_actual(self) -> Array:
        """(6,) mean wrench of coils and core on the tool over the last `advance` [N, N·m about the tool's origin]."""
        return self._wrench.copy()

    def state(self) -> State:
        """True state of the tool."""
        return read_tool(self._tool, self._t)

    @property
    def depth(self) -> float:
        """Present deflection of the surface under the tool [m]; 0: no contact."""
        return float(self._state["depth"][0])


def lift(p: Array, contact: float, is_dome: bool) -> Array:
    """Return `p` (3,) [m], raised to the tool's origin at contact, `contact` [m] up or out, if it is below.

    >>> lift(np.array([0.0, 0.0, 0.01]), 0.05, True).tolist()
    [0.0, 0.0, 0.05]
    """
    if not is_dome:
        return np.array([p[0], p[1], max(float(p[2]), contact)])
    distance = float(np.linalg.norm(p))
    if distance < 1e-9:
        return np.array([0.0, 0.0, contact])
    lifted: Array = p * max(1.0, contact / distance)
    return lifted


def quantise_reading(values: Array, step: float) -> Array:
    """Round `values` (m,) to steps of a converter, in the same unit; step 0: ideal.

    >>> quantise_reading(np.array([0.26]), 0.1).round(3).tolist()
    [0.3]
    """
    stepped: Array = np.rint(values / step) * step if step > 0.0 else values
    return stepped
