"""An electromagnet's physics in compiled code: some steps of coils, core, tool, dome and hand."""

from __future__ import annotations

import numpy as np

from haptorb.devices.electromagnet.passive_pull import pull
from haptorb.devices.electromagnet.ring_tool import fill_per_ampere
from haptorb.numerics.arrays import Array, Records, fields
from haptorb.numerics.compiled import kernel
from haptorb.physics.sources.charged_ring import dipole_on_charges
from haptorb.simulation.electromagnet.core import CORE, core_step
from haptorb.simulation.electromagnet.sensors import SENSES
from haptorb.simulation.electromagnet.true_heat import COILS, NODES
from haptorb.simulation.parts.coils import network_coil_step
from haptorb.simulation.parts.hand import fill_remaining_rotation
from haptorb.simulation.parts.tool import TOOL, contact, matrix, move, set_goal

__all__ = ["ELECTROMAGNET", "advance"]

#: All that a simulated electromagnet remembers but its coils, and the numbers that it goes by.
ELECTROMAGNET = fields(
    ("tool", TOOL),
    ("senses", SENSES),
    ("nearest", "f8"),  # distance from the centre [m] below which the core's pull is that there
    ("dt", "f8"),  # of a step [s]
    ("steps", "i8"),  # in one call
    ("heat", "f8", (NODES, NODES + COILS)),  # `ThermalNetwork.step` of a step
    ("core_temperature", "f8"),  # temperature of what lies between the coils [K]
    ("core", CORE),
    ("wrench", "f8", (6,)),  # of coils and core on the tool, mean of the last call [N, N·m]
    ("depth", "f8"),  # how far the dome gives way under the tool [m]
)


@kernel
def advance(
    electromagnet: Records, coils: Records, duties: Array, wish_p: Array, wish_q: Array, rows: Array, table: Array,
    moment_per_current: Array,
) -> None:  # fmt: skip
    """Some steps of coils, core, tool, dome and hand: `electromagnet` (1,) ELECTROMAGNET and `coils` (m,) COIL advance.

    duties (m,); the hand goes to wish_p (3,) [m] and wish_q (4,) where they are numbers and a turn, else to where it
    went; rows (4, n) charges of the tool's magnet; table of the core's pull; moment_per_current (3, m) [m²].
    """
    e = electromagnet[0]
    tool, truth, dt, count = e.tool, e.wrench, e.dt, coils.size
    set_goal(tool, wish_p, wish_q)
    R = np.empty((3, 3))
    per_moment, per_current = np.empty((6, 3)), np.empty((6, count))
    given, total, passive = np.empty(6), np.empty(6), np.empty(6)
    turn, axis = np.empty(3), np.empty(3)
    for k in range(count):
        coils[k].duty = duties[k]
    truth[:] = 0.0
    for _ in range(e.steps):
        matrix(tool.q[:], R)
        dipole_on_charges(rows, R, tool.p[:], per_moment)
        fill_per_ampere(per_moment, moment_per_current, per_current)
        for i in range(3):
            axis[i] = R[i, 2]
        passive[:] = 0.0
        pull(table, e.nearest, tool.p[:], axis, passive)
        for k in range(count):  # the power that leaves the coil's circuit is the power that the tool gets
            emf = 0.0
            for i in range(3):
                emf += per_current[i, k] * tool.v[i]
            for i in range(3):
                emf += per_current[3 + i, k] * tool.w[i]
            coils[k].emf = emf
        e.core_temperature = network_coil_step(coils, e.heat, e.core_temperature, dt)
        core_step(e.core, moment_per_current, coils, dt)
        for i in range(6):
            given[i] = passive[i]
            for k in range(count):
                given[i] += per_current[i, k] * coils[k].mean
            for k in range(3):
                given[i] += per_moment[i, k] * e.core.extra[k]
            truth[i] += given[i] / e.steps
            total[i] = given[i]
        e.depth = contact(tool, R, dt, total)
        fill_remaining_rotation(tool.q, tool.goal_q, turn)
        move(tool, R, turn, total, dt)
