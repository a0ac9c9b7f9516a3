"""Session description for the page: device, scene, worlds with parameters, limits and code texts; and the pointer."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Mapping
from functools import lru_cache, singledispatch
from threading import Thread
from typing import Any, NamedTuple, final

import numpy as np

from haptorb.arrays import Array
from haptorb.beams import Hook, compliance, compute_bent_shape
from haptorb.control.saturation import Saturation
from haptorb.control.trip_reasons import Trip
from haptorb.devices.base import Device, device_function
from haptorb.devices.coil_array import CoilArray, array_geometry
from haptorb.devices.electromagnet import SphericalElectromagnet, electromagnet_geometry
from haptorb.devices.geometry import Geometry, RoundPart
from haptorb.devices.motor import SphericalMotor, motor_geometry
from haptorb.errors import HaptorbError, InputError
from haptorb.recording.row import RowLayout
from haptorb.runtime.servo import Servo
from haptorb.runtime.trackers.pose_filter import describe_trip
from haptorb.runtime.trackers.registry import has_feed
from haptorb.version import __version__
from haptorb.web.wire import Columns, PointerMessage
from haptorb.worlds import CATALOGUE, Outlet, SnapFit, World, find_world
from haptorb.worlds.base import parameters
from haptorb.worlds.base import values as parameter_values
from haptorb.worlds.dynamic import DynamicWorld, find_number

__all__ = [
    "HANG_TIMEOUTS",
    "HANG_TIMEOUTS_SIMULATED",
    "HangTimeouts",
    "PointerRelay",
    "RecordedServo",
    "describe_parts",
    "describe_scene",
    "describe_world",
    "hang_timeouts_for",
    "list_shapes",
    "object_scene",
    "prepare",
    "press_buttons",
    "read_world",
    "session",
    "world_now",
    "world_remarks",
    "worlds",
    "worlds_now",
]


# --------------------------------------------------------------------------------------------------
# Scene descriptions of devices and of bodies of worlds, in metres and radians.
#
# There is one description for each scene in `web/src/scene`.


@device_function
@singledispatch
def describe_scene(device: Device) -> dict[str, Any]:
    """Describe the scene of a device for the console, by its kind.

    Parameters
    ----------
    device : Device
        The device.

    Returns
    -------
    dict
        JSON: `kind` is the name of a scene in `web/src/scene`, `gives` is "torque" where the device renders torque. By
        default axes, a marker for the mover, and the device's geometry.
    """
    geometry = device.geometry()
    return {
        "kind": "axes",
        "rest": device.rest_position.tolist(),
        **({} if geometry is None else describe_parts(geometry)),
    }


@describe_scene.register(SphericalElectromagnet)
def _(device: SphericalElectromagnet) -> dict[str, Any]:
    return {
        "kind": "dome",
        "dome_radius": device.dome_radius,
        "dome_wall": device.dome_wall,
        "contact_distance": device.contact_distance,
        "shell_thickness": device.shell_thickness,
        "workspace": device.workspace_half_angle,
        "core_radius": device.core_radius,
        "magnet": {
            "worn": device.tool.worn,
            "outer_radius": device.tool.outer_radius,
            "length": device.tool.length,
            "tip_distance": device.tool.tip_distance,
        },
        **describe_parts(electromagnet_geometry(device)),
    }


@describe_scene.register(CoilArray)
def _(device: CoilArray) -> dict[str, Any]:
    surface, magnet = device.surface, device.tool.magnets[0]
    if not surface.is_dome:
        return {
            "kind": "plate",
            "rest": device.rest_position.tolist(),
            "height": surface.height,
            "half_width": list(surface.half_width),
            "contact_height": device.contact_height,
            "thickness": surface.thickness,
            "tool": {"origin": [0.0, 0.0, device.contact_height], "tip_distance": device.tool.tip_distance},
            **describe_parts(array_geometry(device)),
        }
    return {
        "kind": "dome",
        "dome_radius": surface.dome_radius,
        "dome_wall": surface.wall,
        "contact_distance": device.contact_height,
        "shell_thickness": surface.thickness,
        "workspace": surface.half_angle,
        "core_radius": 0.0 if device.core is None else device.core.radius,
        "magnet": {
            "worn": False,
            "outer_radius": magnet.outer_radius,
            "length": magnet.length,
            "tip_distance": device.tool.tip_distance,
        },
        **describe_parts(array_geometry(device)),
    }


@describe_scene.register(SphericalMotor)
def _(device: SphericalMotor) -> dict[str, Any]:
    return {
        "kind": "motor",
        "gives": "torque",
        "workspace": device.workspace_tilt,
        "handle_length": device.rotor.handle_length,
        "groups": np.asarray(device.groups, dtype=np.float64).tolist(),
        **describe_parts(motor_geometry(device)),
    }


def describe_parts(geometry: Geometry) -> dict[str, Any]:
    """Describe a geometry for the console.

    Parameters
    ----------
    geometry : Geometry
        Geometry of a device.

    Returns
    -------
    dict
        JSON: round parts, field sensors, marks and edges of a workspace with their positions [m], and notes on what
        the device file omits.
    """
    return {
        "parts": [_describe_part(part) for part in geometry.round_parts],
        "sensors": [spot.position.tolist() for spot in geometry.select_spots("sensor")],
        "marks": [spot.position.tolist() for spot in geometry.select_spots("mark")],
        "edges": [edge.points.tolist() for edge in geometry.edges],
        "notes": list(geometry.notes),
    }


def _describe_part(part: RoundPart) -> dict[str, Any]:
    return {
        "name": part.name,
        "role": part.role,
        "channel": part.channel,
        "position": part.position.tolist(),
        "axis": part.axis.tolist(),
        "inner_radius": part.inner_radius,
        "outer_radius": part.outer_radius,
        "length": part.length,
        "polarity": part.polarity,
        "moves": part.moves,
        "stated": part.stated,
    }


def list_shapes(name: str, values: Mapping[str, Any], own: Mapping[str, World], device: Device) -> list[dict[str, Any]]:
    """List the bodies of the world `name` with `values` on `device`, of the catalogue or of `own`; empty for any other.

    size [m] as in `worlds.base.SHAPES`; place and attitude are indices in the row's memory.
    """
    try:
        world = own[name] if name in own else find_world(name)()
        if not isinstance(world, DynamicWorld):
            return []
        changed = world.replace(**values).for_device(device)
        assert isinstance(changed, DynamicWorld)
        fields = changed.memory_fields
        return [
            {
                "name": shape.name,
                "kind": shape.kind,
                "size": list(shape.size),
                "role": shape.role,
                "at": list(shape.at),
                "points": list(shape.points),
                "corners": list(shape.corners),
                "place": find_number(fields, shape.place, shape.row) if shape.place else None,
                "attitude": find_number(fields, shape.attitude, shape.row) if shape.attitude else None,
            }
            for shape in changed.shapes
        ]
    except Exception:  # a world unknown to this process, or an error in the user's code: only its drawing is lost
        return []


# --------------------------------------------------------------------------------------------------
# Scene of the object that a motor moves: plug, socket, and the bending of hooks, as computed by the world.
#
# All lengths in metres in the object's frame: X' out of the socket, Y' from one hook to the other.


_BEND_POINTS = 7  #: contact points along a wedge for which the deflection of a hook is sent; the page interpolates
_STEM_GAP_FRACTION = 0.8  #: of the gap between the wedges, filled by the stem of a snap-fit part; drawing only
_EDGE_THICKNESS_M = 1.5e-3  #: of the edge of that part; drawing only [m]


def prepare() -> None:
    """Precompute the first scenes in a thread: it takes a second, which would later delay the hand's pose."""
    Thread(target=lambda: [object_scene(name, {}) for name in ("outlet", "snap_fit")], daemon=True).start()


def object_scene(name: str, values: Mapping[str, Any]) -> dict[str, Any] | None:
    """Geometry of the world `name` with `values`; None if there is nothing to draw but the object itself.

    hooks     number of hooks, the first at +Y'
    root      X' of their roots; they extend towards +X'
    back      |Y'| of the side of a hook that faces away from the plug
    width     of a hook, along Z'
    along     (k,) positions along a hook from its root
    section   (k,) thickness there
    at        (n,) possible contact positions
    bends     (n, k) deflection at each position per deflection at the contact, outward positive
    outline   (j, 2) plug: X from its reference point, and half its width there
    floor     X' of the socket's floor
    force     typical force [N]
    """
    return _object_scene(name, _to_key(values))


def world_remarks(name: str, values: Mapping[str, Any]) -> list[str]:
    """Remarks for the user on the world `name` with `values`, such as strain and stress of its hooks."""
    return _remarks(name, _to_key(values))


def _to_key(values: Mapping[str, Any]) -> tuple[tuple[str, float], ...]:
    return tuple(sorted((key, value) for key, value in values.items() if isinstance(value, int | float)))


@lru_cache(maxsize=8)
def _remarks(name: str, values: tuple[tuple[str, float], ...]) -> list[str]:
    try:
        return list(find_world(name)().replace(**dict(values)).remarks)
    except HaptorbError:  # a user's world, unknown to this process
        return []


@lru_cache(maxsize=128)  # the maximum number of designs in a feel session
def _object_scene(name: str, values: tuple[tuple[str, float], ...]) -> dict[str, Any] | None:
    try:
        world = find_world(name)().replace(**dict(values))
    except HaptorbError:  # a user's world, unknown to this process
        return None
    match world:
        case Outlet():
            hook, half = world.hook, 0.5 * world.plug_width
            return _describe_hook_scene(
                hook,
                np.array([hook.peak]),
                hooks=2,
                root=world.arm - hook.peak,
                back=0.5 * world.opening + hook.height + hook.thickness,
                outline=[*world.outline.tolist(), [world.arm + 4e-3, half]],
                floor=0.0,
                force=world.stiffness * (half - 0.5 * world.opening),
            )
        case SnapFit():
            hook, half = world.hook, world.half_width
            stem = max(_STEM_GAP_FRACTION * (half + world.clearance - hook.height), 0.2 * half)
            places = np.linspace(hook.base_length, hook.tip, _BEND_POINTS)
            soft = compliance(hook, hook.peak, world.beam)
            return _describe_hook_scene(
                hook,
                places,
                hooks=world.hooks,
                root=-hook.base_length,
                back=half + world.clearance + hook.thickness,
                outline=[
                    [-_EDGE_THICKNESS_M, half],
                    [0.0, half],
                    [0.0, stem],
                    [hook.tip - hook.base_length + 6e-3, stem],
                ],
                floor=-_EDGE_THICKNESS_M,
                force=hook.youngs_modulus * hook.width * hook.height / float(soft.plus),
            )
    return None


def _describe_hook_scene(hook: Hook, at: Array, **others: Any) -> dict[str, Any]:
    """Describe the scene of `hook` with contacts at `at` (n,), and further entries `others`."""
    corners = [hook.base_length, hook.ramp_end, hook.peak, hook.tip]
    along = np.unique(np.concatenate([np.linspace(0.0, hook.tip, 25), corners]))
    bends = []
    for place in at.tolist():
        shape = compute_bent_shape(hook, place, 1.0, points=65)
        bends.append(np.interp(along, shape[:, 0], shape[:, 1]).tolist())
    return {
        "width": hook.width,
        "along": along.tolist(),
        "section": hook.section(along).tolist(),
        "at": at.tolist(),
        "bends": bends,
        **others,
    }


# --------------------------------------------------------------------------------------------------
# Relay of the page's pointer to the servo: dragged by the user, or at rest where it was released.
#
# During a drag the page's messages refresh the pose: if the page freezes or disconnects, the pose expires and the guard
# releases. Because a browser on a busy computer stutters, short pauses are bridged while its socket is open. A pointer
# at rest sends no messages, so the server refreshes it while the page is connected.
#
# Two timeouts, `HangTimeouts`, bound how long a force may last without the user: of the page's main thread, after
# which its worker drops the pose, and of the worker, after which the server drops it. A real device allows at most
# 0.25 s; then the pose expires (`limits.expiry`), and the guard fades the force out within 50 ms and trips. A simulated
# device cannot hurt anyone, and no tracker has failed: it allows 1 s, then the simulated hand releases the pointer and
# returns to rest within 1.5 s, without a trip. If a page disconnects during a drag, the pose expires with either. Since
# this process may also wait for a processor, the simulated hand keeps its pose for 0.3 s without a message from here.


class HangTimeouts(NamedTuple):
    """Timeouts of a dragged pointer that is not refreshed [s]."""

    page: float  #: from the page's main thread to its worker
    worker: float  #: from the worker to the server


HANG_TIMEOUTS = HangTimeouts(page=0.25, worker=0.15)
HANG_TIMEOUTS_SIMULATED = HangTimeouts(page=1.0, worker=1.0)

_STARVATION_S = 0.3  #: time that a simulated hand bridges while this process gets no processor [s]
#: largest difference of a row's goal from the pointer's that it echoes [m]; the transport is in float32
_ECHO_TOLERANCE_M = 1e-6
#: a hand is at rest this long after its release [s]
SETTLE_TIME_S = 0.5
#: timeout of an echo [s]
_ECHO_TIMEOUT_S = 0.5


def hang_timeouts_for(driver: str) -> HangTimeouts:
    """Timeouts for `driver`: longer for the simulation, which has no power."""
    return HANG_TIMEOUTS_SIMULATED if driver == "sim" else HANG_TIMEOUTS


@final
class PointerRelay:
    """Forwards the controlling page's pointer to the servo, and finds the row that echoes it."""

    def __init__(self, servo: Servo) -> None:
        self._servo = servo
        self._simulated, self._grace = servo.driver == "sim", hang_timeouts_for(servo.driver).worker
        self._keep_alive = _STARVATION_S if self._simulated else 0.0
        self._last: tuple[Array, Array | None, float] | None = None  # the dragged pose, and when it was received
        self._release_time = 0.0  # time of the release [s]
        self._resting: tuple[Array, Array | None] | None = None
        # the page's time stamp, our time, position, orientation
        self._pending: deque[tuple[float, float, Array, Array | None]] = deque(maxlen=64)
        self.held = False

    def point(self, pointer: PointerMessage) -> None:
        """Forward a pointer that moved or was released at `pointer.p`."""
        self._servo.hand.point(pointer.p, pointer.q, keep_alive=self._keep_alive)
        self.held = pointer.held
        self._resting = None if pointer.held else (pointer.p, pointer.q)
        if not pointer.held:
            self._release_time = time.monotonic()
        self._last = (pointer.p, pointer.q, time.monotonic()) if pointer.held else None
        if math.isfinite(pointer.stamp):
            self._pending.append((pointer.stamp, time.monotonic(), pointer.p, pointer.q))

    def refresh(self) -> None:
        """Refresh a hand at rest, or one whose page stutters; call it more often than the device's expiry."""
        if self._resting is not None:
            self._servo.hand.point(*self._resting, keep_alive=self._keep_alive)
        elif self._last is not None:
            if time.monotonic() - self._last[2] < self._grace:  # safety: pointer-bridged
                self._servo.hand.point(self._last[0], self._last[1], keep_alive=self._keep_alive)
            else:
                self.drop()

    def release(self) -> None:
        """Handle a disconnected page: a hand at rest is released, a drag expires.

        A browser that closes a page during a drag first sends a release of the pointer, which does not count as rest.
        """
        if self._resting is not None and time.monotonic() - self._release_time > SETTLE_TIME_S:
            self._servo.hand.release()
        self._clear()

    def drop(self) -> None:
        """End a drag because the page is hidden or hangs.

        A simulated hand releases the tool; the pose of a real device expires."""
        if self._last is None:
            return
        if self._simulated:
            self._servo.hand.release()
        self._clear()

    def home(self) -> None:
        """Release the tool at once; it returns to rest."""
        self._servo.hand.release()
        self._clear()

    def end_expired_drag(self) -> None:
        """Release the hand after an expired drag; to be called before engaging."""
        if not self.held and self._resting is None:
            self._servo.hand.release()

    def _clear(self) -> None:
        self._resting = self._last = None
        self._pending.clear()
        self.held = False

    @property
    def waiting(self) -> bool:
        """Whether a forwarded pointer has not been echoed by a row yet."""
        while self._pending and time.monotonic() - self._pending[0][1] > _ECHO_TIMEOUT_S:
            self._pending.popleft()
        return bool(self._pending)

    def echo(self, targets: Array, turns: Array | None = None) -> float:
        """Time stamp [ms] of the newest pointer that one of the goals echoes, else NaN.

        targets   (n, 3) positions
        turns     (n, 4) orientations, the only difference of a rotor's pointers; None: not compared
        """
        for place in range(len(self._pending) - 1, -1, -1):
            stamp, _, p, q = self._pending[place]
            if not len(targets):
                break
            same = np.abs(targets - p).max(axis=1) < _ECHO_TOLERANCE_M
            if q is not None and turns is not None:
                same &= np.abs(turns - q / np.linalg.norm(q)).max(axis=1) < _ECHO_TOLERANCE_M
            if same.any():
                for _ in range(place + 1):
                    self._pending.popleft()
                return stamp
        return math.nan


_ZERO_CELSIUS_K = 273.15  #: 0 °C [K]
_MAX_NAME_CHARACTERS = 64  #: of a world, a value or a button [characters]
_MAX_VALUES = 64  #: of a world


def worlds(device: Device, own: Mapping[str, World]) -> list[dict[str, Any]]:
    """Describe every world that `device` can render, the user's `own` ones first: name, summary, parameters."""
    found: list[tuple[str, type[World], Mapping[str, Any], frozenset[str]]] = [
        (name, type(world), parameter_values(world), getattr(world, "unused_parameters", frozenset()))
        for name, world in own.items()
    ]
    for name, kind in CATALOGUE.items():
        if name not in own and _is_renderable(device, kind):
            found.append((name, kind, {}, frozenset()))
    return [
        {
            "name": name,
            "about": next(iter((kind.__doc__ or "").strip().splitlines()), ""),
            "parameters": [
                {
                    "name": item.name,
                    "unit": item.unit,
                    "low": item.low,
                    "high": item.high,
                    "default": _to_json(given.get(item.name, item.default)),
                    "about": item.about,
                }
                for item in parameters(kind).values()
                if item.name not in unused
            ],
        }
        for name, kind, given, unused in found
    ]


def _is_renderable(device: Device, kind: type[World]) -> bool:
    try:
        kind().for_device(device)
    except InputError:
        return False
    return True


def _header_text(trip: Trip, tracker: str) -> str:
    """Short text for `trip` in the page's header."""
    if trip is Trip.STOPPED:
        return "stopped"
    return "tracker lost" if trip is Trip.POSE_LOST and tracker != "pointer" else "tripped"


@final
class RecordedServo:
    """Facts of a recorded run in place of a servo: device, driver, tracker and models, from the metadata `run`."""

    part_remarks: tuple[str, ...] = ()  #: not recorded

    def __init__(self, device: Device, run: Mapping[str, str]) -> None:
        self.device = device
        self.layout = RowLayout.of(device)
        self.modes = device.kind.modes
        self.driver = run.get("driver", "") or "unknown"
        self.tracker = run.get("tracker", "") or "pointer"
        self.models: tuple[str, ...] = tuple(device.models)
        self.model = run.get("model", "") if run.get("model", "") in self.models else self.models[0]
        self.render = run.get("render", "") or None


def session(servo: Servo | RecordedServo, started: str) -> dict[str, Any]:
    """Describe the session for /api/session, without `worlds_now`; `started` identifies a run of the server."""
    device = servo.device
    heat = device.coils.heat
    return {
        "version": __version__,
        "started": started,
        "simulated": servo.driver == "sim",
        "steered": not has_feed(servo.tracker),
        "heartbeat_timeout": hang_timeouts_for(servo.driver).page,
        "device": {"name": device.name, "title": device.title, "source": device.source},
        "scene": {"gives": "force", **describe_scene(device)},
        "modes": list(servo.modes),
        "models": list(servo.models),
        "parts": list(servo.part_remarks),
        "saturations": [one.text for one in Saturation],
        "columns": Columns(servo.layout, bool(servo.modes)).describe(),
        "coils": list(device.coils.names),
        "limits": {
            "force": device.limits.force,
            "torque": device.limits.torque,
            "expiry": device.limits.expiry,
            "current": device.coils.current_limit.tolist(),
            "warn": heat.warn - _ZERO_CELSIUS_K,
            "derate": heat.derate - _ZERO_CELSIUS_K,
            "stop": heat.stop - _ZERO_CELSIUS_K,
        },
        "trips": {
            str(int(trip)): {"word": _header_text(trip, servo.tracker), "text": describe_trip(trip, servo.tracker)}
            for trip in Trip
            if trip is not Trip.NONE
        },
    }


def worlds_now(servo: Servo, *, shown: bool = True) -> dict[str, Any]:
    """Describe the selectable worlds and the current one, which is hidden unless `shown`."""
    return {"worlds": worlds(servo.device, servo.own_worlds if shown else {}), "world": world_now(servo, shown=shown)}


def world_now(servo: Servo, *, shown: bool = True) -> dict[str, Any]:
    """Describe the current world: name, values, inverted model, drawing and remarks."""
    name, values = servo.world
    plain = {key: _to_json(value) for key, value in values.items()}
    return describe_world(servo, name, plain, servo.model, shown=shown)


def describe_world(servo: Servo, name: str, values: Mapping[str, Any], model: str, *, shown: bool) -> dict[str, Any]:
    """Describe the world `name` with `values` in JSON types, its drawing and remarks; unless `shown`, only `model`."""
    if not shown:
        return {"name": "hidden", "values": {}, "model": model, "scene": None, "shapes": [], "remarks": []}
    return {
        "name": name,
        "values": dict(values),
        "model": model,
        "scene": object_scene(name, values) if servo.modes else None,
        "shapes": list_shapes(name, values, servo.own_worlds, servo.device),
        "remarks": _own_remarks(servo, name) or world_remarks(name, values),
    }


def _own_remarks(servo: Servo, name: str) -> list[str]:
    """Remarks of a user's world, such as a scene."""
    world = servo.own_worlds.get(name)
    return [] if world is None else list_world_remarks(world)


def list_world_remarks(world: World, period: float | None = None) -> list[str]:
    """Remarks on `world` and each scene in it; with the `period` of a tick [s] also on simulation steps."""
    found: list[str] = []
    for part in getattr(world, "parts", (world,)):
        listed = getattr(part, "list_remarks", None)
        found += part.remarks if listed is None or period is None else listed(period)
    return found


def _to_json(value: Any) -> Any:
    """Convert tuples and arrays to lists."""
    return list(value) if isinstance(value, tuple | list | np.ndarray) else value


def press_buttons(servo: Servo, command: Mapping[str, Any]) -> None:
    """Set the buttons pressed on a page, for connected programs. Raises InputError unless it is a list of names."""
    pressed = command.get("pressed")
    if not isinstance(pressed, list) or not all(isinstance(name, str) for name in pressed[:_MAX_VALUES]):
        raise InputError("buttons are a list of names: a, b, c")
    servo.press([name[:_MAX_NAME_CHARACTERS] for name in pressed[:_MAX_VALUES]])


def read_world(command: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
    """Read name and values of the world in a page's command. Raises InputError if they are invalid."""
    name, values = command.get("name"), command.get("values", {})
    if not isinstance(name, str) or not isinstance(values, dict):
        raise InputError("a world needs a name (text) and values (an object)")
    if (
        len(name) > _MAX_NAME_CHARACTERS
        or len(values) > _MAX_VALUES
        or any(len(key) > _MAX_NAME_CHARACTERS for key in values)
    ):
        raise InputError(
            f"a world has a name of at most {_MAX_NAME_CHARACTERS} characters, "
            f"and at most {_MAX_VALUES} values with such"
        )
    for key, value in values.items():
        numbers = value if isinstance(value, list) else [value]
        if len(numbers) > _MAX_VALUES or not all(type(one) in (int, float) for one in numbers):
            raise InputError(f"a world's value is a number or a list of numbers; {key} is neither")
    return name, values
