"""What the page must know before the first frame: device, worlds and their sliders, limits, words for codes."""

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
from haptorb.control.allocation import Saturation
from haptorb.control.trips import Trip
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
from haptorb.web.wire import Columns, Pointer
from haptorb.worlds import CATALOGUE, Outlet, SnapFit, World, find_world
from haptorb.worlds.base import parameters
from haptorb.worlds.base import values as parameter_values
from haptorb.worlds.dynamic import DynamicWorld, find_number

__all__ = [
    "PATIENCE",
    "PATIENCE_SIMULATED",
    "Patience",
    "PointerRelay",
    "RecordedServo",
    "describe_parts",
    "describe_scene",
    "describe_world",
    "list_shapes",
    "patience_for",
    "prepare",
    "press_buttons",
    "read_world",
    "session",
    "target_scene",
    "world_now",
    "world_remarks",
    "worlds",
    "worlds_now",
]


# --------------------------------------------------------------------------------------------------
# What the page draws of a device and of worlds with memory, in metres and radians.
#
# There is one description for each scene that `web/src/scene` knows.


@device_function
@singledispatch
def describe_scene(device: Device) -> dict[str, Any]:
    """How the page draws `device`, by its kind; by default axes, a marker for the mover, and the device's geometry.

    `kind` is one of the scenes that `web/src/scene` has; `gives` is "torque" where the device renders torque.
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
    """Round parts, field sensors and marks where they are, and what the device file does not state of them."""
    return {
        "parts": [_describe_part(part) for part in geometry.round_parts],
        "sensors": [spot.position.tolist() for spot in geometry.select_spots("sensor")],
        "marks": [spot.position.tolist() for spot in geometry.select_spots("mark")],
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
    """Bodies of the world `name` with `values` on `device`, of the catalogue or of the `own` ones; none of any other.

    size [m] as `worlds.shape.SHAPES` says; place and attitude are indices in the row's memory.
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
    except Exception:  # a world that this process does not know by name, or the user's code: only its picture is lost
        return []


# --------------------------------------------------------------------------------------------------
# What a motor moves, for those who draw it: plug, socket, and how its hooks bend, as the world computes them.
#
# All lengths in metres in the target's frame: X' out of the socket, Y' from one hook to the other.


_PLACES = 7  #: along a wedge, where the deflection of a hook is sent; between them it is interpolated
_STEM = 0.8  #: of the gap between the wedges that the part of a snap-fit fills behind its edges: for the eye
_HEAD = 1.5e-3  #: thickness of that part's edge: for the eye [m]


def prepare() -> None:
    """Load, in a thread, what the first scenes need: it takes a second, and later a hand would wait for it."""
    Thread(target=lambda: [target_scene(name, {}) for name in ("outlet", "snap_fit")], daemon=True).start()


def target_scene(name: str, values: Mapping[str, Any]) -> dict[str, Any] | None:
    """Geometry of the world `name` with `values`; None where there is nothing to draw but the target itself.

    hooks     how many, the first at +Y'
    root      X' of their roots; they reach towards +X'
    back      |Y'| of the side of a hook that looks away from the plug
    width     of a hook, along Z'
    along     (k,) places on a hook from its root
    section   (k,) its thickness there
    at        (n,) places where it may be touched
    bends     (n, k) how far each place is bent per deflection at the touched place, outward positive
    outline   (j, 2) plug: X from its reference point, and half its width there
    floor     X' of the socket's floor
    force     a force of the order of those that come [N]
    """
    return _target_scene(name, _to_key(values))


def world_remarks(name: str, values: Mapping[str, Any]) -> list[str]:
    """What should be said about the world `name` with `values`: strain and stress of its hooks; else nothing."""
    return _remarks(name, _to_key(values))


def _to_key(values: Mapping[str, Any]) -> tuple[tuple[str, float], ...]:
    return tuple(sorted((key, value) for key, value in values.items() if isinstance(value, int | float)))


@lru_cache(maxsize=8)
def _remarks(name: str, values: tuple[tuple[str, float], ...]) -> list[str]:
    try:
        return list(find_world(name)().replace(**dict(values)).remarks)
    except HaptorbError:  # a world of the user's own that this process does not know by name
        return []


@lru_cache(maxsize=128)  # as many designs as a feel session has
def _target_scene(name: str, values: tuple[tuple[str, float], ...]) -> dict[str, Any] | None:
    try:
        world = find_world(name)().replace(**dict(values))
    except HaptorbError:  # a world of the user's own that this process does not know by name
        return None
    match world:
        case Outlet():
            hook, half = world.hook, 0.5 * world.plug_width
            return _describe_scene(
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
            stem = max(_STEM * (half + world.clearance - hook.height), 0.2 * half)
            places = np.linspace(hook.base_length, hook.tip, _PLACES)
            soft = compliance(hook, hook.peak, world.beam)
            return _describe_scene(
                hook,
                places,
                hooks=world.hooks,
                root=-hook.base_length,
                back=half + world.clearance + hook.thickness,
                outline=[[-_HEAD, half], [0.0, half], [0.0, stem], [hook.tip - hook.base_length + 6e-3, stem]],
                floor=-_HEAD,
                force=hook.youngs_modulus * hook.width * hook.height / float(soft.plus),
            )
    return None


def _describe_scene(hook: Hook, at: Array, **others: Any) -> dict[str, Any]:
    """The scene of `hook`, touched at `at` (n,), and what else there is."""
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
# The hand behind the page's pointer: held by a person, or at rest where it was released.
#
# While a person drags, their own messages keep the pose fresh: if the page freezes or goes away in the middle of a drag
# it is not renewed, it expires, and the guard releases. A browser on a busy computer stutters, though: as long as its
# socket is open, a pause is bridged. A hand at rest has no such person behind it, so the server keeps it fresh for as
# long as the page stays connected.
#
# Two limits, `Patience`, bound how long a force may last that no person holds: what the page's main thread may be
# silent before the page's own worker drops the pose, and what the worker may be silent before this end does. A real
# device allows a quarter of a second at most; then the pose expires (`limits.expiry`), the guard fades the force out
# within 50 ms and trips. A simulated one cannot hurt anyone, and no tracker has failed: it allows a second, and then
# the simulated hand releases the pointer and is back at rest within 1.5 s, without a trip. A page that goes away in the
# middle of a drag lets the pose expire with either. This process too may wait for a processor: the simulated hand stays
# where it is for 0.3 s without a word from here.


class Patience(NamedTuple):
    """How long a held pointer stays valid without renewal [s]."""

    page: float  #: from the page's main thread to its worker
    worker: float  #: from the worker to the server


PATIENCE = Patience(page=0.25, worker=0.15)
PATIENCE_SIMULATED = Patience(page=1.0, worker=1.0)

_STARVATION = 0.3  #: what a simulated hand bridges while this process has no processor [s]
#: how close the row's goal must be to the page's to be its answer [m]: float32 on the way
_SAME = 1e-6
#: this long after its release a hand is at rest [s]
SETTLED = 0.5
#: an answer that has not come by then will not come [s]
_PATIENCE = 0.5


def patience_for(driver: str) -> Patience:
    """What `driver` allows: more where nothing is powered."""
    return PATIENCE_SIMULATED if driver == "sim" else PATIENCE


@final
class PointerRelay:
    """Passes the controlling page's pointer to the servo, and finds the row that answers it."""

    def __init__(self, servo: Servo) -> None:
        self._servo = servo
        self._simulated, self._grace = servo.driver == "sim", patience_for(servo.driver).worker
        self._patience = _STARVATION if self._simulated else 0.0
        self._last: tuple[Array, Array | None, float] | None = None  # what is held, and when it was last said
        self._rested = 0.0  # when it was released
        self._resting: tuple[Array, Array | None] | None = None
        # the page's stamp, our time, position, orientation
        self._pending: deque[tuple[float, float, Array, Array | None]] = deque(maxlen=64)
        self.held = False

    def point(self, pointer: Pointer) -> None:
        """The page's pointer moved, or was released at `pointer.p`."""
        self._servo.hand.point(pointer.p, pointer.q, patience=self._patience)
        self.held = pointer.held
        self._resting = None if pointer.held else (pointer.p, pointer.q)
        if not pointer.held:
            self._rested = time.monotonic()
        self._last = (pointer.p, pointer.q, time.monotonic()) if pointer.held else None
        if math.isfinite(pointer.stamp):
            self._pending.append((pointer.stamp, time.monotonic(), pointer.p, pointer.q))

    def keep(self) -> None:
        """Refresh a hand at rest, or one whose page stutters; to be called well within the device's expiry."""
        if self._resting is not None:
            self._servo.hand.point(*self._resting, patience=self._patience)
        elif self._last is not None:
            if time.monotonic() - self._last[2] < self._grace:  # safety: pointer-bridged
                self._servo.hand.point(self._last[0], self._last[1], patience=self._patience)
            else:
                self.drop()

    def release(self) -> None:
        """The page went away: a hand at rest goes home, a drag is left to expire.

        A browser that closes a page in the middle of a drag first sends that the pointer was released; that is no rest.
        """
        if self._resting is not None and time.monotonic() - self._rested > SETTLED:
            self._servo.hand.release()
        self._forget()

    def drop(self) -> None:
        """The page is hidden or hangs: a drag is over. A simulated hand releases the tool; a real device's pose is left
        to expire."""
        if self._last is None:
            return
        if self._simulated:
            self._servo.hand.release()
        self._forget()

    def let_go(self) -> None:
        """Release the tool at once."""
        self._servo.hand.release()
        self._forget()

    def end_expired_drag(self) -> None:
        """Before engaging: a drag that was left to expire is over, the hand goes home."""
        if not self.held and self._resting is None:
            self._servo.hand.release()

    def _forget(self) -> None:
        self._resting = self._last = None
        self._pending.clear()
        self.held = False

    @property
    def waiting(self) -> bool:
        """Whether a pointer has been passed on and no row has answered it yet."""
        while self._pending and time.monotonic() - self._pending[0][1] > _PATIENCE:
            self._pending.popleft()
        return bool(self._pending)

    def echo(self, targets: Array, turns: Array | None = None) -> float:
        """The page's time stamp [ms] of the newest pointer that one of the goals answers, else NaN.

        targets   (n, 3) positions
        turns     (n, 4) orientations; a rotor's pointers differ in nothing else. None: they do not matter
        """
        for place in range(len(self._pending) - 1, -1, -1):
            stamp, _, p, q = self._pending[place]
            if not len(targets):
                break
            same = np.abs(targets - p).max(axis=1) < _SAME
            if q is not None and turns is not None:
                same &= np.abs(turns - q / np.linalg.norm(q)).max(axis=1) < _SAME
            if same.any():
                for _ in range(place + 1):
                    self._pending.popleft()
                return stamp
        return math.nan


_KELVIN = 273.15
_NAME = 64  #: of a world or a value [characters]
_VALUES = 64  #: of a world


def worlds(device: Device, own: Mapping[str, World]) -> list[dict[str, Any]]:
    """Every world that `device` can render, the user's `own` ones first: name, what it is, its parameters in order."""
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


def _word(trip: Trip, tracker: str) -> str:
    """What the header says for `trip`."""
    if trip is Trip.STOPPED:
        return "stopped"
    return "tracker lost" if trip is Trip.POSE_LOST and tracker != "pointer" else "tripped"


@final
class RecordedServo:
    """Device, driver, tracker and models of a run, by the recording's note of it."""

    part_remarks: tuple[str, ...] = ()  #: the numbers alone show how a part was rendered

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
    """The JSON of /api/session but for `worlds_now`; `started` distinguishes one run of the server from another."""
    device = servo.device
    heat = device.coils.heat
    return {
        "version": __version__,
        "started": started,
        "simulated": servo.driver == "sim",
        "steered": not has_feed(servo.tracker),
        "patience": patience_for(servo.driver).page,
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
            "warn": heat.warn - _KELVIN,
            "derate": heat.derate - _KELVIN,
            "stop": heat.stop - _KELVIN,
        },
        "trips": {
            str(int(trip)): {"word": _word(trip, servo.tracker), "text": describe_trip(trip, servo.tracker)}
            for trip in Trip
            if trip is not Trip.NONE
        },
    }


def worlds_now(servo: Servo, *, shown: bool = True) -> dict[str, Any]:
    """The worlds that can be chosen, and the present one; nothing but its name unless it may be `shown`."""
    return {"worlds": worlds(servo.device, servo.own_worlds if shown else {}), "world": world_now(servo, shown=shown)}


def world_now(servo: Servo, *, shown: bool = True) -> dict[str, Any]:
    """Name and values of the world that is felt now, the model that is inverted, what there is to draw and to say."""
    name, values = servo.world
    plain = {key: _to_json(value) for key, value in values.items()}
    return describe_world(servo, name, plain, servo.model, shown=shown)


def describe_world(servo: Servo, name: str, values: Mapping[str, Any], model: str, *, shown: bool) -> dict[str, Any]:
    """The world `name` with `values` as JSON has them, what there is to draw and to say; of one that is not `shown`
    nothing but the `model`."""
    if not shown:
        return {"name": "hidden", "values": {}, "model": model, "scene": None, "shapes": [], "remarks": []}
    return {
        "name": name,
        "values": dict(values),
        "model": model,
        "scene": target_scene(name, values) if servo.modes else None,
        "shapes": list_shapes(name, values, servo.own_worlds, servo.device),
        "remarks": _own_remarks(servo, name) or world_remarks(name, values),
    }


def _own_remarks(servo: Servo, name: str) -> list[str]:
    """Remarks of a world of the user's own, such as a scene."""
    world = servo.own_worlds.get(name)
    return [] if world is None else list_world_remarks(world)


def list_world_remarks(world: World, period: float | None = None) -> list[str]:
    """What should be said about `world` and each scene in it; with the `period` of a tick [s] also about steps."""
    found: list[str] = []
    for part in getattr(world, "parts", (world,)):
        listed = getattr(part, "list_remarks", None)
        found += part.remarks if listed is None or period is None else listed(period)
    return found


def _to_json(value: Any) -> Any:
    """`value` as JSON has it."""
    return list(value) if isinstance(value, tuple | list | np.ndarray) else value


def press_buttons(servo: Servo, command: Mapping[str, Any]) -> None:
    """The buttons that a page holds down, for programs that are connected; InputError for what is no list of names."""
    pressed = command.get("pressed")
    if not isinstance(pressed, list) or not all(isinstance(name, str) for name in pressed[:_VALUES]):
        raise InputError("buttons are a list of names: a, b, c")
    servo.press([name[:_NAME] for name in pressed[:_VALUES]])


def read_world(command: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
    """Name and values of the world that a page asks for; InputError if they cannot be one's."""
    name, values = command.get("name"), command.get("values", {})
    if not isinstance(name, str) or not isinstance(values, dict):
        raise InputError("a world needs a name (text) and values (an object)")
    if len(name) > _NAME or len(values) > _VALUES or any(len(key) > _NAME for key in values):
        raise InputError(f"a world has a name of at most {_NAME} characters, and at most {_VALUES} values with such")
    for key, value in values.items():
        numbers = value if isinstance(value, list) else [value]
        if len(numbers) > _VALUES or not all(type(one) in (int, float) for one in numbers):
            raise InputError(f"a world's value is a number or a list of numbers; {key} is neither")
    return name, values
