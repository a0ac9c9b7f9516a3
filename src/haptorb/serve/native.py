"""Server of `--serve native`: programs for Force Dimension's and OpenHaptics' interfaces, through shared memory.

The libraries in `native/` map a small file that this process writes: facts, then the state after every tick. They write
one command into it, with its time by CLOCK_MONOTONIC. This process polls it four times per tick and forwards it like
any client's; every value in the file is validated here before use.
"""

from __future__ import annotations

import math
import mmap
import os
import select
import stat
from contextlib import suppress
from dataclasses import dataclass
from functools import singledispatch
from pathlib import Path
from struct import Struct
from time import monotonic, sleep
from typing import Any, NamedTuple, final

from haptorb.analysis.stability import GRIPS, SampledLoop
from haptorb.control.linkage import MOTOR_GAINS
from haptorb.control.trip_reasons import Trip
from haptorb.devices.arm import Arm
from haptorb.devices.base import Device, device_function, find_object_limits
from haptorb.devices.coil_array import CoilArray
from haptorb.devices.gripper import Gripper
from haptorb.devices.motor import SphericalMotor
from haptorb.errors import InputError
from haptorb.files import folders, foreign_text
from haptorb.runtime.linux import raise_priority, request_exact_timers
from haptorb.serve.base import ServedDevice, ServerPreparation
from haptorb.version import __version__

__all__ = [
    "COMMAND",
    "FACTS",
    "FILE_BYTES",
    "SLOTS",
    "SLOT_SIZE",
    "STATE",
    "VERSION",
    "Claim",
    "Hardware",
    "NativeServer",
    "Page",
    "Placement",
    "describe_hardware",
    "describe_mapping",
    "device_folder",
    "prepare",
    "read_claim",
    "serve",
]


# --------------------------------------------------------------------------------------------------
# The file: three pages of 8-byte words, the same table as native/link/layout.h.


VERSION = 2
_MAGIC = 0x6C6E62726F747061
_PAGE = 4096
FILE_BYTES = 3 * _PAGE  #: of the file [bytes]
_STATES_AT, _COMMAND_AT = _PAGE, 2 * _PAGE
SLOTS, SLOT_SIZE = 4, 960  #: of states, at the end of their page
_SLOTS_AT = 2 * _PAGE - SLOTS * SLOT_SIZE
_COUNT, _PHASE = _STATES_AT // 8, _STATES_AT // 8 + 1  # words: number of states written, and phase of the run
_RUNNING, _ENDED = 1, 2

#: name → (byte in its page, numbers, type: q whole, d float, s text)
Page = dict[str, tuple[int, int, str]]


def _lay_out(*members: tuple[str, int, str]) -> Page:
    found, at = {}, 0
    for name, count, kind in members:
        found[name] = at, count, kind
        at += count if kind == "s" else 8 * count
    assert at <= _PAGE
    return found


FACTS = _lay_out(
    ("magic", 1, "q"), ("version", 1, "q"), ("size", 1, "q"), ("owner", 1, "q"), ("server", 1, "q"),
    ("server_start", 1, "q"), ("type", 1, "q"), ("capabilities", 1, "q"), ("serial", 1, "q"), ("rate", 1, "d"),
    ("workspace", 6, "d"), ("force_max", 1, "d"), ("force_continuous", 1, "d"), ("stiffness_max", 1, "d"),
    ("mass", 1, "d"), ("torque_max", 1, "d"), ("grip_force_max", 1, "d"), ("grip_angle_max", 1, "d"),
    ("grip_length", 1, "d"), ("name", 64, "s"), ("maker", 32, "s"), ("version_text", 32, "s"),
)  # fmt: skip
STATE = _lay_out(
    ("tick", 1, "q"), ("stamp", 1, "q"), ("valid", 1, "q"), ("guard", 1, "q"), ("trip", 1, "q"), ("buttons", 1, "q"),
    ("joints", 1, "q"), ("warmth", 1, "d"), ("position", 3, "d"), ("rotation", 9, "d"), ("velocity", 3, "d"),
    ("angular_velocity", 3, "d"), ("force", 3, "d"), ("torque", 3, "d"), ("grip_angle", 1, "d"),
    ("grip_velocity", 1, "d"), ("grip_force", 1, "d"), ("joint_angles", 8, "d"), ("trip_text", 160, "s"),
)  # fmt: skip
COMMAND = _lay_out(
    ("claim", 1, "q"), ("sequence", 1, "q"), ("owner", 1, "q"), ("stamp", 1, "q"), ("enabled", 1, "q"),
    ("force", 3, "d"), ("torque", 3, "d"), ("grip_force", 1, "d"), ("program", 64, "s"), ("opened", 1, "q"),
)  # fmt: skip


#: numeric part of a state
_NUMBERS = Struct("".join(f"{count}{kind}" for _, count, kind in STATE.values() if kind != "s"))
_JOINTS = 8


# --------------------------------------------------------------------------------------------------
# Description of the device for programs, and the mapping of the tool's pose.


HAS_BASE, HAS_WRIST, HAS_ACTIVE_WRIST, HAS_GRIPPER, HAS_ACTIVE_GRIPPER, SIMULATED = 1, 2, 4, 8, 16, 64
# Device types of Force Dimension's interface with the same capabilities; none has an active wrist without a gripper.
_OMEGA_3, _OMEGA_6, _OMEGA_7, _SIGMA_7 = 33, 34, 35, 104
_TOOL = HAS_BASE | HAS_WRIST | HAS_ACTIVE_WRIST
_PROGRAM_DELAY = 2e-3  #: delay from a pose to the program's force, in addition to the tick [s]
_MOTOR_SCALE = 10.0  #: a motor's object moves by millimetres
_REACH = 0.1  #: half size of the box about the rest position, for a kind of device whose workspace is unknown [m]


@dataclass(frozen=True)
class Hardware:
    """Capabilities of a device for programs of these interfaces; poses and box in the program's frame and scale.

    centre         (3,) origin of the program's frame [m], stator frame
    scale          metres in the program per metre of the tool
    workspace      box of the poses: least x y z, greatest x y z [m]
    """

    type: int
    capabilities: int
    centre: tuple[float, float, float]
    scale: float
    workspace: tuple[float, ...]
    force: float  #: peak [N]
    continuous: float  #: [N]
    torque: float = 0.0  #: peak [N·m]; 0: none is rendered
    mass: float = 0.0  #: of the tool [kg]; 0: unknown
    gripper: Gripper | None = None
    stiffness: float = math.inf  #: limit in the device file, at the point where the world acts [N/m]
    lever: float = 1.0  #: ratio of the hand's travel to the object's

    @property
    def grip_angle(self) -> float:
        """Maximum angle of the gripper [rad]; 0: there is none."""
        gripper = self.gripper
        return 0.0 if gripper is None else 2.0 * math.asin(min(0.5 * gripper.opening / gripper.length, 1.0))


@device_function
@singledispatch
def describe_hardware(device: Device) -> Hardware:
    """Description of `device` for programs; a kind of device with more capabilities registers its own."""
    shell = device.shell
    force, torque = device.limits.force, device.limits.torque
    if shell is None:
        x, y, z = device.rest_position.tolist()
        box = (-_REACH,) * 3 + (_REACH,) * 3
        return Hardware(_OMEGA_6, _TOOL, (x, y, z), 1.0, box, force, force, torque)
    rest, reach = shell.contact_distance, shell.contact_distance + shell.thickness
    box = (-reach, -reach, -rest, reach, reach, shell.thickness)
    return Hardware(_OMEGA_6, _TOOL, (0.0, 0.0, rest), 1.0, box, force, force, torque)


@describe_hardware.register
def _describe_motor(device: SphericalMotor) -> Hardware:
    """Describe a motor: the program moves the object, relative to its own origin, by the travel of the initial tilts.

    Forces come back in mode translate, torques in mode rotate; the greatest that a program may command stay within the
    rotor's torque in every direction.
    """
    force, torque = find_object_limits(device)
    gains = MOTOR_GAINS.translate
    x, y, z = (_MOTOR_SCALE * device.workspace_tilt * gain for gain in gains)
    return Hardware(
        _OMEGA_6, _TOOL, (0.0, 0.0, 0.0), _MOTOR_SCALE, (-y, -x, -z, y, x, z), force, force, torque,
        lever=device.rotor.handle_length / max(gains),
    )  # fmt: skip


@describe_hardware.register
def _describe_array(device: CoilArray) -> Hardware:
    """Describe a coil array: the origin is the tool's contact point in the middle of the plate, or as for any dome."""
    surface, force, torque = device.surface, device.limits.force, device.limits.torque
    if surface.is_dome:
        return describe_hardware.dispatch(object)(device)
    x, y = surface.half_width
    box = (-y, -x, 0.0, y, x, surface.thickness)
    return Hardware(_OMEGA_6, _TOOL, (0.0, 0.0, device.contact_height), 1.0, box, force, force, torque)


@describe_hardware.register
def _describe_arm(device: Arm) -> Hardware:
    """Arm at scale 1, with its gripper if it has one."""
    x, y, z = device.workspace.half
    gripper, sensed = device.gripper, device.effector.orientation != "fixed"
    able = HAS_BASE | (HAS_WRIST if sensed else 0) | (HAS_ACTIVE_WRIST if device.is_turned else 0)
    kind = _OMEGA_6 if sensed else _OMEGA_3
    if gripper is not None:
        able |= HAS_GRIPPER | HAS_ACTIVE_GRIPPER
        kind = _SIGMA_7 if device.is_turned else _OMEGA_7
    return Hardware(
        kind, able, (0.0, 0.0, 0.0), 1.0, (-y, -x, -z, y, x, z), device.limits.force, device.continuous_wrench[0],
        device.limits.torque if device.is_turned else 0.0, mass=device.effector.mass, gripper=gripper,
        stiffness=device.stiffness_limit,
    )  # fmt: skip


def describe_mapping(device: Device, scale: float | None = None) -> str:
    """Describe the mapping of a program's workspace to that of `device` in one line; scale: None for the default.

    >>> from haptorb.devices.loader import load
    >>> describe_mapping(load("arm")).partition(" (")[0]
    'mapping: a program sees a box of 110 × 160 × 160 mm'
    """
    hardware = describe_hardware(device)
    factor = hardware.scale if scale is None else scale
    x, y, z = (
        factor / hardware.scale * 1e3 * (most - least)
        for least, most in zip(hardware.workspace[:3], hardware.workspace[3:], strict=True)
    )
    where = "the object's place at rest" if device.kind.modes else (
        f"({', '.join(f'{1e3 * one:.4g}' for one in hardware.centre)}) mm of the stator's frame"
    )  # fmt: skip
    able = [f"{hardware.force:.3g} N"]
    able += [f"{1e3 * hardware.torque:.3g} mN·m"] if hardware.torque else ["no torque"]
    able += [] if hardware.gripper is None else [f"gripper {hardware.gripper.force:.3g} N"]
    return (
        f"mapping: a program sees a box of {x:.3g} × {y:.3g} × {z:.3g} mm (towards the user, right, up), scale "
        f"{factor:g}, origin at {where}; at most {', '.join(able)}"
    )


@final
@dataclass(frozen=True)
class Placement:
    """Transform from the stator's frame (x right, y away from the user, z up) to the program's: x to the user, y right.

    centre  (3,) origin of the program's frame [m]; scale: metres in the program per metre here

    >>> Placement((0.0, 0.0, 0.5), 2.0).place((0.25, 0.5, 1.0))
    (-1.0, 0.5, 1.0)
    """

    centre: tuple[float, float, float]
    scale: float

    def place(self, p: Any) -> tuple[float, float, float]:
        """Transform a position (3,) [m]."""
        x, y, z = (self.scale * (one - middle) for one, middle in zip(p, self.centre, strict=True))
        return 0.0 - y, x, z  # avoids -0.0 in displays

    @staticmethod
    def turn(vector: Any) -> tuple[float, float, float]:
        """Transform a force or any other vector (3,), in its own unit."""
        x, y, z = vector
        return 0.0 - y, x, z  # avoids -0.0 in displays

    @staticmethod
    def turn_back(vector: Any) -> tuple[float, float, float]:
        """Transform a program's force (3,) [N] to the stator's frame."""
        x, y, z = vector
        return y, 0.0 - x, z


def _turn_rotation(q: tuple[float, float, float, float]) -> tuple[float, ...]:
    """Rotation (9,), row by row, of the orientation `q` (x, y, z, w) in the stator's frame, with the program's axes.

    >>> [one + 0.0 for one in _turn_rotation((0.0, 0.0, 0.0, 1.0))]
    [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    """
    x, y, z, w = -q[1], q[0], q[2], q[3]
    return (
        1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y),
        2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x),
        2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y),
    )  # fmt: skip


# --------------------------------------------------------------------------------------------------
# The commanding process: the claim that a library writes into the file, and whether that process exists.


_PID_BITS, _LIBRARY_BITS = 22, 2


class Claim(NamedTuple):
    """Process, library (1: Force Dimension's, 2: OpenHaptics') and the start of the process, clock ticks since boot."""

    process: int
    library: int
    start: int


def read_claim(number: int) -> Claim:
    """Decode a claim in the file.

    >>> read_claim((77 << 24) | (2 << 22) | 1234)
    Claim(process=1234, library=2, start=77)
    """
    number &= (1 << 64) - 1
    return Claim(
        number & ((1 << _PID_BITS) - 1), number >> _PID_BITS & ((1 << _LIBRARY_BITS) - 1),
        number >> (_PID_BITS + _LIBRARY_BITS),
    )  # fmt: skip


def _process_start(process: int) -> int:
    """Start of a process in clock ticks since boot; −1 if there is no such process."""
    try:
        return int(Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[19])
    except (OSError, ValueError, IndexError):
        return -1


@final
class _Commander:
    """Process of a claim; `alive` until it ends."""

    def __init__(self, claim: Claim) -> None:
        self.name, self._descriptor = f"process {claim.process}", -1
        with suppress(OSError):
            descriptor = os.pidfd_open(claim.process)
            # After the descriptor is open, the PID cannot be reused by another process.
            own = Path(f"/proc/{claim.process}").stat().st_uid == os.geteuid()
            if own and _process_start(claim.process) == claim.start:  # safety: native-commander-exists
                self._descriptor = descriptor
            else:
                os.close(descriptor)
        self._poll = select.poll()
        if self._descriptor >= 0:
            self._poll.register(self._descriptor, select.POLLIN)

    @property
    def alive(self) -> bool:
        """Whether the process runs, or is stopped."""
        return self._descriptor >= 0 and not self._poll.poll(0)

    def close(self) -> None:
        """Close the descriptor of the process."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1


# --------------------------------------------------------------------------------------------------
# Server: writes the newest row into the file, and reads the newest command from it.


_POLL_INTERVAL_S = 2e-4  #: polling interval [s]
_REPORT_INTERVAL_S = 0.5  #: interval between two reports of the commanding program [s]
_MAX_NAME = 40  #: characters of a program's name, without its number
_MAX_READS = 5
_OPENED = (_COMMAND_AT + COMMAND["opened"][0]) // 8  # word: time of the first opening; 0: none
_LEAST_COSINE = 1e-3  #: sine of half the gripper's angle below which the opening does not determine the angular rate


@final
class NativeServer:
    """Writes the rows of `served` into the mapped file `descriptor`, and forwards the commands in it."""

    def __init__(self, served: ServedDevice, descriptor: int, scale: float | None = None) -> None:
        self.served = served
        self._map = mmap.mmap(descriptor, FILE_BYTES)
        memory = memoryview(self._map)
        self._bytes, self._words, self._floats = memory, memory.cast("q"), memory.cast("d")
        hardware = describe_hardware(served.device)
        self._placement = Placement(hardware.centre, hardware.scale if scale is None else scale)
        self._hardware = hardware
        self._direct = not served.facts.get("modes")
        layout = served.layout
        names = (
            "t", "wall", "valid", "guard", "trip", "v", "w", "winding", "part", "gain", "clutch_share", "gripper",
            "gripper_v", "gripper_force",
        )  # fmt: skip
        self._at = {name: layout[name] for name in names}
        self._at["p"] = layout["p" if self._direct else "object"]
        self._at["q"] = layout["q" if self._direct else "object_q"]
        self._at["rotor"] = layout["q"]
        self._at["force"] = layout["wrench_commanded" if self._direct else "object_wrench"]
        self._tick, self._t, self._p, self._known = -1, 0.0, (0.0, 0.0, 0.0), False
        self._velocity, self._q, self._trips = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), [0] * SLOTS
        self._turning, self._opened = (0.0, 0.0, 0.0), False
        self._claim, self._session, self._sequence = 0, 0, 0
        self._commander: _Commander | None = None
        self._commands, self._counted_at, self._counted = 0, monotonic(), 0
        self._changed = False  # commanding programs since the last report
        self.program = ""  #: that commands
        self.refused = 0  #: invalid commands: non-finite numbers, processes that do not exist
        self._write_facts()
        self.publish()

    def poll(self) -> None:
        """Publish a new row, and forward a new command."""
        if self.served.tick_count != self._tick:
            self.publish()
        self._take()

    # ---- facts and state ----

    def _write_facts(self) -> None:
        served, device, hardware = self.served, self.served.device, self._hardware
        rate = float(served.facts["rate_hz"])
        simulated = SIMULATED if served.facts["driver"] == "sim" else 0
        loop = SampledLoop(1 / rate, _PROGRAM_DELAY, 1 / rate)
        # A program's spring acts on the object, which moves less than the hand by the lever ratio.
        stiffness = min(hardware.lever**2 * loop.largest(GRIPS["light"]), hardware.stiffness) / self._placement.scale
        gripper, limits = hardware.gripper, self._find_limits()
        values: dict[str, Any] = {
            "version": VERSION, "size": FILE_BYTES, "owner": os.geteuid(), "server": os.getpid(),
            "server_start": _process_start(os.getpid()), "type": hardware.type,
            "capabilities": hardware.capabilities | simulated, "serial": os.getppid() & 0xFFFF, "rate": rate,
            "workspace": [self._placement.scale / hardware.scale * side for side in hardware.workspace],
            "force_max": min(hardware.force, limits[0]), "force_continuous": min(hardware.continuous, limits[0]),
            "stiffness_max": stiffness, "mass": hardware.mass, "torque_max": min(hardware.torque, limits[1]),
            "grip_force_max": 0.0 if gripper is None else min(gripper.force, limits[2]),
            "grip_length": 0.0 if gripper is None else gripper.length, "grip_angle_max": hardware.grip_angle,
            "name": f"haptorb {device.name}", "maker": "haptorb", "version_text": __version__,
        }  # fmt: skip
        for name, value in values.items():
            self._store(0, FACTS[name], value)
        self._words[FACTS["magic"][0] // 8] = _MAGIC  # last: a library that reads it reads all

    def _find_limits(self) -> tuple[float, float, float]:
        """Limits of the world on clients' forces [N], torques [N·m] and gripper forces [N]."""
        world = self.served.world
        values = world.get("values" if world.get("name") == "remote" else "remote") or {}
        stated = [values.get(name) for name in ("limit", "torque_limit", "gripper_limit")]
        force, torque, gripper = (float(one) if isinstance(one, int | float) else math.inf for one in stated)
        return force, torque, gripper

    def _store(self, page: int, place: tuple[int, int, str], value: Any) -> None:
        at, count, kind = place
        if kind == "s":
            text = str(value).encode()[: count - 1]
            self._bytes[page + at : page + at + count] = text.ljust(count, b"\0")
            return
        cells = self._words if kind == "q" else self._floats
        first = (page + at) // 8
        for i, one in enumerate(value if count > 1 else (value,)):
            cells[first + i] = one

    def publish(self) -> None:
        """Write the newest row as the state for programs."""
        served = self.served
        self._tick = served.tick_count
        row = served.latest()
        if row is None:
            return
        n, at = row.tolist(), self._at
        self._note_pose(n)
        code = n[at["trip"].start]
        trip = int(code) if math.isfinite(code) else 0
        place, turn = self._placement.place, self._placement.turn
        (force, torque), wall, guard = self._find_rendered(n), n[at["wall"].start], n[at["guard"].start]
        number = self._words[_COUNT] + 1
        slot = _SLOTS_AT + SLOT_SIZE * (number % SLOTS)
        _NUMBERS.pack_into(
            self._bytes, slot,
            self._tick, int(1e9 * wall) if math.isfinite(wall) else 0, n[at["valid"].start] == 1.0,
            int(guard) if math.isfinite(guard) else 0, trip, served.button_bits, 0 if self._direct else 3,
            self._find_warmth(n[at["winding"]]),
            *place(self._p), *_turn_rotation(self._q), *turn(self._velocity), *turn(self._turning),
            *turn(force), *turn(torque), *self._find_grip(n), *self._find_joints(n),
        )  # fmt: skip
        if trip != self._trips[number % SLOTS]:
            self._trips[number % SLOTS] = trip
            self._store(slot, STATE["trip_text"], _explain_trip(trip))
        self._words[_PHASE], self._words[_COUNT] = _RUNNING, number

    def _find_warmth(self, windings: list[float]) -> float:
        heat = self.served.device.coils.heat
        warmest = max(_finite(windings), default=0.0)
        return min(max((warmest - heat.ambient) / (heat.derate - heat.ambient), 0.0), 1.0)

    def _find_rendered(self, n: list[float]) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Rendered force (3,) [N] and torque (3,) [N·m] on the object that the program moves."""
        at = self._at
        wrench = _finite(n[at["force"]])
        if self._direct:
            part = n[at["part"].start]
            pushes, turns = float(part != 1.0), float(part != 0.0 and self._hardware.torque > 0.0)
        else:  # the world's wrench as passed by guard and clutch
            gain, (moving, turning) = _finite([n[at["gain"].start]])[0], _finite(n[at["clutch_share"]])
            pushes, turns = gain * moving, gain * turning
        return tuple(pushes * one for one in wrench[:3]), tuple(turns * one for one in wrench[3:])

    def _find_grip(self, n: list[float]) -> tuple[float, float, float]:
        """Angle [rad], its rate [rad/s] and force [N] of the gripper."""
        gripper, at = self._hardware.gripper, self._at
        if gripper is None:
            return 0.0, 0.0, 0.0
        opening, rate, force = _finite([n[at[name].start] for name in ("gripper", "gripper_v", "gripper_force")])
        angle = 2.0 * math.asin(min(max(0.5 * opening / gripper.length, 0.0), 1.0))
        return angle, rate / (gripper.length * max(math.cos(0.5 * angle), _LEAST_COSINE)), force

    def _find_joints(self, n: list[float]) -> tuple[float, ...]:
        """(8,) angles of a motor's rotor about the program's x, y and z [rad]: R = Rx(a) Ry(b) Rz(c); else zeros."""
        if self._direct:
            return (0.0,) * _JOINTS
        x, y, z, w = n[self._at["rotor"]]
        if not math.isfinite(x + y + z + w):
            return (0.0,) * _JOINTS
        r = _turn_rotation((x, y, z, w))
        angles = math.atan2(-r[5], r[8]), math.asin(min(max(r[2], -1.0), 1.0)), math.atan2(-r[1], r[0])
        return angles + (0.0,) * (_JOINTS - 3)

    def _note_pose(self, n: list[float]) -> None:
        """Store the last valid pose and its velocity; that of a target is its displacement since the previous row."""
        at = self._at
        if not self._known:
            self._p = self._placement.centre
        if n[at["valid"].start] != 1.0:
            self._velocity = self._turning = (0.0, 0.0, 0.0)
            return
        x, y, z = n[at["p"]]
        if not math.isfinite(x + y + z):
            return
        t = n[at["t"].start]
        if self._direct:
            scale = self._placement.scale
            a, b, c = _finite(n[at["v"]])
            self._velocity = (scale * a, scale * b, scale * c)
            a, b, c = _finite(n[at["w"]])
            self._turning = (a, b, c)
        elif self._known and t > self._t:
            scale = self._placement.scale / (t - self._t)
            self._velocity = (scale * (x - self._p[0]), scale * (y - self._p[1]), scale * (z - self._p[2]))
        a, b, c, d = n[at["q"]]
        if math.isfinite(a + b + c + d):
            if not self._direct and self._known and t > self._t:
                self._turning = _find_rate(self._q, (a, b, c, d), t - self._t)
            self._q = (a, b, c, d)
        self._p, self._t, self._known = (x, y, z), t, True

    # ---- command ----

    def _take(self) -> None:
        words, start = self._words, _COMMAND_AT // 8
        if not self._opened and words[_OPENED]:
            self._opened = True
            self.served.begin_hand()
        claim = words[start]
        if claim != self._claim:
            self._change_commander(claim)
        if self._commander is None:
            return
        if not self._commander.alive:  # safety: native-exit-told
            self._change_commander(0, "exited")
            words[start] = 0
            return
        sequence = words[start + 1]
        if sequence == self._sequence or sequence & 1:
            return
        for _ in range(_MAX_READS):
            owner, stamp, enabled = words[start + 2], words[start + 3], words[start + 4]
            wrench = self._floats[start + 5 : start + 12].tolist()
            after = words[start + 1]
            if after == sequence:
                break
            sequence = after
        if sequence & 1 or owner != self._claim:  # safety: native-own-commands-only
            return
        self._sequence = sequence
        self._commands += 1
        if not enabled:
            self.served.lose(self._session, "released")
            return
        back = self._placement.turn_back
        if not self.served.command(
            self._session, back(wrench[:3]), arrival=1e-9 * stamp, torque=back(wrench[3:6]), gripper=wrench[6]
        ):
            self.refused += 1

    def _change_commander(self, claim: int, end: str = "released") -> None:
        self._changed = True
        if self._commander is not None:
            self.served.lose(self._session, end)
            self._commander.close()
            self._commander, self.program = None, ""
        self._claim = claim
        if claim == 0:
            return
        commander = _Commander(read_claim(claim))
        if not commander.alive:
            commander.close()
            self.refused += 1
            self._words[_COMMAND_AT // 8] = 0
            self._claim = 0
            return
        self._commander, self._session = commander, self.served.open_session()
        at, count, _ = COMMAND["program"]
        text = bytes(self._bytes[_COMMAND_AT + at : _COMMAND_AT + at + count]).split(b"\0")[0]
        name = text.decode(errors="replace").strip()
        self.program = f"{foreign_text(name, _MAX_NAME)} ({commander.name})" if name else commander.name

    @property
    def changed(self) -> bool:
        """Whether the commanding program has changed since the last report."""
        return self._changed

    def report(self, address: str) -> None:
        """Publish the commanding program, and the previous ones."""
        now, self._changed = monotonic(), False
        rate = (self._commands - self._counted) / max(now - self._counted_at, 1e-3)
        self._counted, self._counted_at = self._commands, now
        clients = [{"name": self.program, "session": self._session, "rate_hz": round(rate, 1),
                    "holds": self.served.holder == self._session}] if self._commander is not None else []  # fmt: skip
        self.served.report("native", address, clients, refused=self.refused)

    def close(self) -> None:
        """Release the commanding program and mark the run as ended."""
        self._change_commander(0)
        self._words[_PHASE] = _ENDED


def _find_rate(
    before: tuple[float, float, float, float], now: tuple[float, float, float, float], dt: float
) -> tuple[float, float, float]:
    """Angular velocity (3,) [rad/s] between two orientations (x, y, z, w) `dt` [s] apart, for a small rotation.

    >>> [round(one, 3) for one in _find_rate((0, 0, 0, 1), (0, 0, 1e-3, 1), 1e-3)]
    [0.0, 0.0, 2.0]
    """
    x, y, z, w = before
    a, b, c, d = now
    # Vector part of now times the inverse of before; its sign is that of the shorter rotation.
    turn = (w * a - d * x - (b * z - c * y), w * b - d * y - (c * x - a * z), w * c - d * z - (a * y - b * x))
    factor = math.copysign(2.0 / dt, x * a + y * b + z * c + w * d)
    return factor * turn[0], factor * turn[1], factor * turn[2]


def _explain_trip(code: int) -> str:
    return next((trip.text for trip in Trip if trip == code), f"tripped, code {code}")


def _finite(numbers: list[float]) -> tuple[float, ...]:
    return tuple(one if math.isfinite(one) else 0.0 for one in numbers)


# --------------------------------------------------------------------------------------------------
# Location for programs: a folder that only this account can open, one file per run.


_FORM = "native[:SCALE]"
_MAX_SCALE = 1000.0


def device_folder() -> Path:
    """Return the folder of this account's devices, created if missing. InputError if it belongs to another account."""
    refused = []
    for parent in folders():
        folder = parent / f"haptorb-native-{os.geteuid()}"
        try:
            folder.mkdir(mode=0o700, exist_ok=True)
            found = folder.lstat()
        except OSError as cause:
            refused.append(f"{folder}: {cause.strerror}")
            continue
        if stat.S_ISDIR(found.st_mode) and found.st_uid == os.geteuid() and not found.st_mode & 0o077:
            return folder
        refused.append(f"{folder} belongs to another account, or others may open it")
    raise InputError(f"--serve native finds no place for its file: {'; '.join(refused)}")


def _remove_stale(folder: Path) -> None:
    import fcntl  # not at the top: Windows has none

    for path in folder.glob("*.device"):
        with suppress(OSError):
            descriptor = os.open(path, os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)  # its server would hold the lock
                path.unlink()
            finally:
                os.close(descriptor)


def prepare(where: str) -> ServerPreparation:
    """Create the file, locked while a process of this run has it open; `where` is the scale of a program's metres."""
    import fcntl  # not at the top: Windows has none

    scale = None
    if where:
        try:
            scale = float(where)
        except ValueError:
            scale = math.nan
        if not 1 / _MAX_SCALE <= scale <= _MAX_SCALE:
            raise InputError(
                f"--serve {_FORM}: metres for a program of one metre of the tool, 0.001 to 1000; got '{where}'"
            )
    folder = device_folder()
    _remove_stale(folder)
    path = folder / f"{os.getpid()}.device"
    path.unlink(missing_ok=True)
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        os.posix_fallocate(descriptor, 0, FILE_BYTES)
    except BaseException:
        os.close(descriptor)
        path.unlink(missing_ok=True)
        raise
    return ServerPreparation(
        {"path": str(path), "scale": scale}, str(path), [descriptor],
        describe=lambda device: (describe_mapping(device, scale),),
    )  # fmt: skip


def serve(spec: dict[str, Any], descriptors: list[int], served: ServedDevice) -> None:
    """Serve the file until the servo ends, then remove it."""
    path = Path(spec["path"])
    try:
        request_exact_timers()
        raise_priority()
        server = NativeServer(served, descriptors[0], spec["scale"])
        try:
            report = 0.0
            while not served.over:
                server.poll()
                if monotonic() >= report or server.changed:
                    report = monotonic() + _REPORT_INTERVAL_S
                    server.report(str(path))
                sleep(_POLL_INTERVAL_S)
        finally:
            server.close()
    finally:
        path.unlink(missing_ok=True)
