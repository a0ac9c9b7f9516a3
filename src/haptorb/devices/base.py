"""Base class of all devices: coils with heating, supply, limits, and wrench map."""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import singledispatch
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from haptorb.arrays import Array, check_finite, record, rotation, vectors
from haptorb.devices.build_checks import BuildCheck
from haptorb.devices.geometry import Geometry
from haptorb.display import Presentable, facts_html, format_number, format_quantity, format_vector, table_html
from haptorb.errors import InputError, UnknownName
from haptorb.files import parse_toml
from haptorb.magnetics.coil import COPPER_RESISTIVITY
from haptorb.thermal import ThermalNetwork, TwoNode, resistance_ratio

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pydantic import BaseModel

__all__ = [
    "MAX_DISTANCE_M",
    "ROOM_TEMPERATURE_K",
    "Coils",
    "Device",
    "DeviceKind",
    "DeviceText",
    "Heat",
    "HeatCoupling",
    "Implementation",
    "Inheritance",
    "Limits",
    "Shell",
    "State",
    "Supply",
    "WrenchMap",
    "check_distance",
    "device_function",
    "endurance",
    "own_implementations",
    "register_implementations",
    "require",
    "require_geometry",
    "rotation_to_axis",
    "unsupported",
]


# --------------------------------------------------------------------------------------------------
# The file that a device was built from, with those that it is based on: whatever carries them can build it again.


_MAX_BASES_CHARACTERS = 1_000_000  #: letters of the files that a device is based on


@dataclass(frozen=True)
class Inheritance:
    """Keys that a variant's file states itself; all other values are those of its base device."""

    base: str
    own: tuple[str, ...]  #: dotted keys
    dropped: tuple[str, ...]  #: keys of the base that do not hold for it


@dataclass(frozen=True)
class DeviceText:
    """own    the file itself
    bases  what its `based_on` says, and those of its bases → the file that this names
    """

    own: str
    bases: Mapping[str, str] = field(default_factory=dict)

    @property
    def inheritance(self) -> Inheritance | None:
        """Keys that the file states itself, if it is based on another; None if it is complete.

        >>> DeviceText("based_on = 'omni'\\nname = 'a'\\n[tool]\\nlength = '20 mm'").inheritance
        Inheritance(base='omni', own=('tool.length',), dropped=())
        """
        raw = parse_toml(self.own)
        if "based_on" not in raw:
            return None
        base, dropped = str(raw.pop("based_on")), tuple(map(str, raw.pop("drop", ())))
        for key in ("name", "title", "source", "kind"):
            raw.pop(key, None)
        return Inheritance(base, tuple(_list_leaves(raw, "")), dropped)

    def as_note(self) -> dict[str, str]:
        """Serialise for the metadata of a recording."""
        return {"file": self.own} | ({"bases": json.dumps(dict(self.bases), ensure_ascii=False)} if self.bases else {})

    @classmethod
    def from_note(cls, note: Mapping[str, str]) -> DeviceText | None:
        """What a recording notes; None if it does not carry the file. Bases that are none are left out.

        >>> text = DeviceText("based_on = 'mine'", {"mine": "..."})
        >>> DeviceText.from_note(text.as_note()) == text
        True
        """
        if not note.get("file"):
            return None
        written = note.get("bases", "")
        try:
            found = json.loads(written) if len(written) <= _MAX_BASES_CHARACTERS else {}
        except (ValueError, RecursionError):
            found = {}
        bases = found.items() if isinstance(found, dict) else ()
        return cls(note["file"], {key: text for key, text in bases if isinstance(text, str)})


def _list_leaves(table: Mapping[str, Any], prefix: str) -> Iterator[str]:
    """Dotted keys of everything in `table`; a table with a "value" is a value."""
    for key, inner in table.items():
        if isinstance(inner, Mapping) and "value" not in inner:
            yield from _list_leaves(inner, f"{prefix}{key}.")
        else:
            yield prefix + key


# --------------------------------------------------------------------------------------------------
# Pose and motion of the mover: the state that worlds, estimators and devices share.


def rotation_to_axis(axis: ArrayLike) -> Array:
    """The rotation R_SR, shape (3, 3), that turns the mover's z axis to `axis` by the smallest angle.

    Raises InputError for the zero vector.

    >>> bool((rotation_to_axis((0, 0, 2)) == np.eye(3)).all())
    True
    """
    z = vectors(axis, "axis")
    length = float(np.linalg.norm(z))
    if length == 0.0:
        raise InputError("axis must not be the zero vector: it has no direction")
    x, y, c = z / length
    if c < -1 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    k = 1.0 / (1.0 + c)
    return np.array([[1 - k * x * x, -k * x * y, x], [-k * x * y, 1 - k * y * y, y], [-x, -y, c]])


MAX_DISTANCE_M = 1.0  #: distance from the device's centre at which no tool can be meant [m]


def check_distance(places: Array, what: str, farthest: float = MAX_DISTANCE_M) -> None:
    """Raise InputError if one of `places` (..., 3) [m] is more than `farthest` from the centre: it is in millimetres.

    >>> check_distance(np.array([0.0, 0.0, 50.0]), "p", farthest=2.0)  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    haptorb.errors.InputError: p must be within 2 m of the device's centre; got (0, 0, 50) m. It is in metres: ...
    """
    each = places.reshape(-1, 3)
    distances = np.linalg.norm(each, axis=1)
    if distances.max(initial=0.0) > farthest:
        place = ", ".join(f"{x:.6g}" for x in each[int(distances.argmax())].tolist())
        raise InputError(
            f"{what} must be within {farthest:g} m of the device's centre; got ({place}) m. It is in metres: 50 mm are "
            "0.05"
        )


@record
class State:
    """Pose and motion of the mover (a tool's magnet, or a rotor) in the stator frame S.

    `State.at` makes one for a tool, `State.from_rotation` one for a rotor.

    Parameters
    ----------
    t : float
        Time [s].
    R_SR : ndarray, shape (3, 3)
        Rotation from the mover's frame to the stator frame; a tool's magnetic moment lies along the mover's +z.
    p : ndarray, shape (3,)
        Position of the mover's origin [m]: a tool's magnet centre; zero for a rotor.
    w : ndarray, shape (3,)
        Angular velocity in the stator frame [rad/s].
    v : ndarray, shape (3,)
        Velocity of p in the stator frame [m/s].

    Examples
    --------
    >>> tool = State.at((0.0, 0.0, 0.05))           # 50 mm above the centre
    >>> tool.distance, tool.axis.tolist()
    (0.05, [0.0, 0.0, 1.0])
    """

    t: float
    R_SR: Array
    p: Array
    w: Array
    v: Array

    @classmethod
    def at(
        cls,
        position: ArrayLike,
        axis: ArrayLike | None = None,
        *,
        R_SR: ArrayLike | None = None,
        v: ArrayLike = (0.0, 0.0, 0.0),
        w: ArrayLike = (0.0, 0.0, 0.0),
        t: float = 0.0,
    ) -> State:
        """Make the state of a tool at a position, its axis radial unless an orientation is given.

        Parameters
        ----------
        position : array_like, shape (3,)
            Position of the tool's magnet in the stator frame [m], at most 1 m from the device's centre.
        axis : array_like, shape (3,), optional
            Direction of the tool's axis [1], of any length.
        R_SR : array_like, shape (3, 3), optional
            Rotation from the tool's frame to the stator frame, instead of `axis`.
        v : array_like, shape (3,)
            Velocity in the stator frame [m/s].
        w : array_like, shape (3,)
            Angular velocity in the stator frame [rad/s].
        t : float
            Time [s].

        Returns
        -------
        State
            The state.

        Raises
        ------
        InputError
            For other shapes, for a place more than 1 m from the device's centre, for both orientations at once, and for
            the centre without one.

        Examples
        --------
        >>> State.at((0.0, 0.05, 0.0)).axis.tolist()
        [0.0, 1.0, 0.0]
        """
        p = vectors(position, "position")
        if p.shape != (3,):
            raise InputError(f"position must have shape (3,); got {p.shape}")
        check_distance(p, "position")
        if axis is not None and R_SR is not None:
            raise InputError("give the orientation as axis or as R_SR, not both")
        if R_SR is not None:
            R = rotation(R_SR, "R_SR")
        elif axis is None and not p.any():
            raise InputError("at the centre no direction is radial: give axis or R_SR")
        else:
            R = rotation_to_axis(p if axis is None else axis)
        return cls(float(check_finite(t, "t")), R, p, vectors(w, "w"), vectors(v, "v"))

    @classmethod
    def from_rotation(cls, R_SR: ArrayLike, *, w: ArrayLike = (0.0, 0.0, 0.0), t: float = 0.0) -> State:
        """Make the state of a rotor, turned about the motor's centre.

        Parameters
        ----------
        R_SR : array_like, shape (3, 3)
            Rotation from the rotor's frame to the stator frame.
        w : array_like, shape (3,)
            Angular velocity in the stator frame [rad/s].
        t : float
            Time [s].

        Returns
        -------
        State
            The state; p and v are zero.

        Raises
        ------
        InputError
            If R_SR is not a rotation, or a number is not finite.

        Examples
        --------
        >>> State.from_rotation(np.eye(3)).p.tolist()
        [0.0, 0.0, 0.0]
        """
        return cls(float(check_finite(t, "t")), rotation(R_SR, "R_SR"), np.zeros(3), vectors(w, "w"), np.zeros(3))

    def __repr__(self) -> str:
        """Place and axis, and on a second line the motion, if there is any."""
        facts = dict(self._list_facts())
        still = not (self.v.any() or self.w.any())
        motion = "" if still else f"\n v {facts['velocity v']}, w {facts['angular velocity w']}"
        return f"<State at t = {facts['time t']}: p {facts['position p']}, axis {facts['axis']}{motion}>"

    def _repr_html_(self) -> str:
        return facts_html("State of the mover", self._list_facts())

    def _list_facts(self) -> list[tuple[str, str]]:
        """Names and figures with units."""
        return [
            ("time t", f"{format_number(self.t, 6)} s"),
            ("position p", format_vector(self.p, "m", 4)),
            ("axis", f"({', '.join(f'{x + 0.0:.3f}' for x in self.axis.round(3).tolist())})"),
            ("velocity v", format_vector(self.v, "m/s")),
            ("angular velocity w", format_vector(self.w, "rad/s")),
        ]

    @property
    def axis(self) -> Array:
        """(3,) the mover's z axis in the stator frame: the direction of a tool's moment, or of a handle."""
        return self.R_SR[:, 2]

    @property
    def distance(self) -> float:
        """Distance of p from the device's centre [m]."""
        x, y, z = self.p
        return float((x * x + y * y + z * z) ** 0.5)


# --------------------------------------------------------------------------------------------------
# The wrench map at a pose: wrench per ampere, and the passive wrench without current.


_NAMES = ("F_x", "F_y", "F_z", "T_x", "T_y", "T_z")


@record
class WrenchMap:
    """Wrench per ampere of each channel on the mover, and the passive wrench at zero current, at one pose.

    In the stator frame; torques are about the mover's origin p.

    Parameters
    ----------
    matrix : ndarray, shape (6, m)
        Force [N/A] above torque [N·m/A], one column per channel.
    passive : ndarray, shape (6,)
        Wrench at zero current [N, N·m], of a soft core or a regulator.
    names : tuple of str
        The channels' names; none: "channel 1" and so on.

    Notes
    -----
    The wrench is linear in the currents: w = matrix @ i + passive. Saturation and eddy currents are left out.

    Examples
    --------
    >>> at_rest = WrenchMap(np.eye(6)[:, :3], np.array([0.0, 0.0, -1.0, 0.0, 0.0, 0.0]))
    >>> at_rest.wrench(np.array([0.0, 0.0, 2.5])).tolist()
    [0.0, 0.0, 1.5, 0.0, 0.0, 0.0]
    """

    matrix: Array
    passive: Array
    names: tuple[str, ...] = ()

    def __repr__(self) -> str:
        """Maximum force and torque per ampere over the channels, and the wrench at zero current."""
        force, torque = (format_quantity(float(part.max(initial=0.0)), unit) for part, unit in self._sizes())
        still = [format_quantity(float(np.linalg.norm(self.passive[i : i + 3])), u) for i, u in ((0, "N"), (3, "N·m"))]
        return (
            f"<WrenchMap of {self.matrix.shape[1]} channels: up to {force} and {torque}; "
            f"passive {still[0]} and {still[1]}>"
        )

    def _repr_html_(self) -> str:
        """One row per component, one column per channel, the passive wrench last."""
        units = ("mN", "mN", "mN", "mN·m", "mN·m", "mN·m")
        matrix, passive = (np.where(np.abs(a) < 1e-9 * np.abs(a).max(), 0.0, a) for a in (self.matrix, self.passive))
        rows = [
            [f"{name} [{unit}/A]", *map(format_number, [1e3 * x for x in row]), f"{format_number(1e3 * still)} {unit}"]
            for name, unit, row, still in zip(_NAMES, units, matrix.tolist(), passive.tolist(), strict=True)
        ]
        channels = self.names or [f"channel {n}" for n in range(1, self.matrix.shape[1] + 1)]
        return facts_html(repr(self)[1:-1], [], table_html(["", *channels, "passive"], rows))

    def _sizes(self) -> tuple[tuple[Array, str], tuple[Array, str]]:
        """(m,) size of each channel's force [N/A], and of its torque [N·m/A]."""
        return (np.linalg.norm(self.force, axis=0), "N/A"), (np.linalg.norm(self.torque, axis=0), "N·m/A")

    @property
    def force(self) -> Array:
        """(3, m) force per current [N/A]."""
        return self.matrix[:3]

    @property
    def torque(self) -> Array:
        """(3, m) torque per current [N·m/A]: a motor's torque characteristic K, Bai 2012 eq. (2)."""
        return self.matrix[3:]

    def wrench(self, currents: Array) -> Array:
        """Compute the wrench of given currents, including the passive part.

        Parameters
        ----------
        currents : ndarray, shape (m,)
            Current of each channel [A].

        Returns
        -------
        ndarray, shape (6,)
            Force [N], then torque about the mover's origin [N·m], in the stator frame.
        """
        wrench: Array = self.matrix @ currents + self.passive
        return wrench


# --------------------------------------------------------------------------------------------------
# Kinds of device, and functions whose implementation depends on the kind.
#
# A class of devices names its record (`Device.kind`) and has methods for what belongs to this layer. What higher layers
# do differently is a `functools.singledispatch` function of theirs on the class of the device: `make_allocator`,
# `simulate`, `describe_scene` and others. Each stands in the package that it belongs to, where every kind has its
# implementation.


@dataclass(frozen=True, kw_only=True)
class DeviceKind:
    """Kind of device: its name, and the initial state of a run.

    Parameters
    ----------
    name : str
        Value of `kind` in a device file.
    title : str
        Name in sentences: "spherical motor", or for several "spherical motors".
    world : str
        Name of the default world.
    modes : tuple of str
        Names of the linkage's modes; empty for a direct linkage.
    contacts : int
        Number of contacts of a `ContactWorld` in each row, filled by the linkage.
    file : type, optional
        Class of the device file, a subclass of `DeviceFile`; None: devices are made in Python.
    """

    name: str
    title: str
    world: str
    modes: tuple[str, ...] = ()
    contacts: int = 0
    file: type[BaseModel] | None = None


F = TypeVar("F", bound=Callable[..., Any])
_FUNCTIONS: list[Any] = []


def device_function(function: F) -> F:
    """Decorator above `functools.singledispatch`, for a function that differs between kinds of device.

    Other processes import haptorb's kinds and those of a user's module. A kind that is defined in a script goes there
    by value, and its implementations of these functions with it: see `own_implementations`.
    """
    _FUNCTIONS.append(function)
    return function


Implementation: TypeAlias = tuple[Any, type, Callable[..., Any]]  #: function, class of device, what it does for that


@device_function
@singledispatch
def find_object_limits(device: Device) -> tuple[float, float]:
    """Force [N] and torque [N·m] on what a world acts on that `device` gives at most, in every direction: for most
    devices, whose object is the mover, the guard's limits."""
    return device.limits.force, device.limits.torque


def own_implementations(device: Device) -> tuple[Implementation, ...]:
    """The implementations that a user's code registered for the class of `device` or for a base of it."""
    classes = (one for one in device.__class__.__mro__ if issubclass(one, Device))
    own = [one for one in classes if not one.__module__.startswith("haptorb.")]
    return tuple(
        (function, one, function.registry[one]) for function in _FUNCTIONS for one in own if one in function.registry
    )


def register_implementations(found: Sequence[Implementation]) -> None:
    """Register what `own_implementations` found in another process."""
    for function, kind, implementation in found:
        function.register(kind, implementation)


def unsupported(device: Device, what: str, function: Any) -> InputError:
    """The error for a program `what` whose device function has no implementation for the kind of `device`."""
    *others, last = sorted(f"{one.kind.title}s" for one in function.registry if "kind" in vars(one))
    able = f"{', '.join(others)} and {last}" if others else last
    return InputError(f"device '{device.name}' is a {device.kind.title}; {what} works for {able}")


@dataclass(frozen=True)
class HeatCoupling:
    """Thermal coupling between channels: one core, or former, between their windings."""

    core_capacity: float  #: [J/K]
    winding_to_core: tuple[float, ...]  #: (m,) conductance of each winding [W/K]


@dataclass(frozen=True)
class Heat:
    """Two bodies in series per channel, winding → body → air, equal for all channels; and their thermal coupling.

    One time constant cannot reproduce the published endurances (Zárate 2020 §III and §V); two can.
    """

    winding_capacity: float  #: [J/K]
    body_capacity: float  #: [J/K]
    winding_to_body: float  #: conductance [W/K]
    body_to_air: float  #: conductance [W/K]
    ambient: float  #: [K]
    warn: float  #: winding temperature at which the user is warned [K]
    derate: float  #: from here currents are reduced [K]
    stop: float  #: here the coils go off [K]
    coupling: HeatCoupling | None = None  #: None: no channel warms another
    tolerance: float = 0.0  #: relative: how far capacities and conductances may be off

    @property
    def coil(self) -> TwoNode:
        """Winding and body of one channel, without the coupling to others."""
        return TwoNode(self.winding_capacity, self.body_capacity, self.winding_to_body, self.body_to_air)

    def network(self, channels: int) -> ThermalNetwork:
        """All `channels` and their coupling: nodes are the windings, the bodies and, if there is one, the core."""
        coupling = self.coupling
        if coupling is None:
            return ThermalNetwork.of_coils(self.coil, np.zeros(channels), 1.0)
        return ThermalNetwork.of_coils(self.coil, coupling.winding_to_core, coupling.core_capacity)


_SURPLUS = 1.25  #: a current limit that far above what the supply drives is within tolerances and warmth
ROOM_TEMPERATURE_K = 293.15  #: 20 °C, of COPPER_RESISTIVITY and of a supply held against a resistance [K]


@dataclass(frozen=True)
class Coils:
    """Electrical data of the channels; arrays have one entry per channel."""

    names: tuple[str, ...]
    resistance: Array  #: (m,) at the reference temperature [Ω]
    inductance: Array  #: (m,) [H]
    current_limit: Array  #: (m,) greatest magnitude that may be commanded [A]
    temperature_coefficient: float  #: relative resistance change per kelvin [1/K]
    reference_temperature: float  #: [K]
    heat: Heat

    @property
    def copper_resistivity(self) -> float:
        """Of annealed copper at the reference temperature [Ω·m], with the coils' temperature coefficient."""
        return COPPER_RESISTIVITY * resistance_ratio(
            self.temperature_coefficient, ROOM_TEMPERATURE_K, self.reference_temperature
        )

    def resistance_at(self, temperature: Array) -> Array:
        """(m,) resistance [Ω] at winding `temperature` (m,) [K]."""
        return self.resistance * resistance_ratio(self.temperature_coefficient, self.reference_temperature, temperature)


@dataclass(frozen=True)
class Supply:
    """The supply of the coils: a voltage, chopped in steps, and its current sensor."""

    voltage: float  #: [V]
    duty_bits: int  #: resolution of the duty cycle's magnitude
    current_noise: float  #: standard deviation of one current reading [A]
    current_step: float  #: quantum of one current reading [A]
    power: float = np.inf  #: greatest power that it gives to all channels together [W]


CONTACT_RATE = 150.0  #: of the force of a contact of 500 N/m that a hand meets at 0.3 m/s [N/s]
HANDOVER_TIME_S = 0.02  #: in which the greatest force of a device can fade to zero [s]


@dataclass(frozen=True)
class Limits:
    """Limits that the guard enforces, for the mover as a whole and for every channel."""

    force: float  #: maximum commanded force [N]
    torque: float  #: maximum commanded torque [N·m]
    slew: float  #: maximum slew rate of a channel's current [A/s]
    expiry: float  #: age at which a command or a pose is worth nothing [s]
    force_rate: float  #: greatest rate of a client's force, and of the force while another world takes over [N/s]
    torque_rate: float  #: the same of torque [N·m/s]


@dataclass(frozen=True)
class Shell:
    """Space above a dome in which the tool's magnet can move."""

    contact_distance: float  #: of the magnet from the dome's centre when a radial tool touches the dome [m]
    thickness: float  #: height above contact up to which forces are rendered [m]
    moment: float  #: of the tool's magnet [A·m²]
    dome_radius: float  #: outside of the dome [m]


@dataclass(frozen=True, kw_only=True)
class Device(Presentable, ABC):
    """Electrical data, limits and models of one device; the base class of every kind of device.

    `haptorb.load` builds one from a device file. Frozen; a variant is made with `dataclasses.replace`. A subclass is a
    new kind of device: it names its record in `kind` and implements `wrench_map`.

    Parameters
    ----------
    name : str
        Short name; recordings and calibrations refer to it.
    title : str
        Title in reports.
    source : str
        Source of the values.
    coils : Coils
        Resistance [Ω], inductance [H], current limit [A] and heat of each channel.
    supply : Supply
        Voltage [V], power [W] and resolution of the supply.
    limits : Limits
        Limits of force [N], torque [N·m] and current slew rate [A/s] that the guard enforces.
    assumed : Mapping
        Key of the device file → reason, for values that the source does not give.
    digest : str
        SHA-256 of everything in the file; a recording names its device by it.
    models : tuple of str
        Names of the models that `wrench_map` knows, the default first.
    text : DeviceText, optional
        The device file with those that it is based on.

    Notes
    -----
    `sustained_current` and `sustained_current_together` follow from the steady state of the thermal network, with every
    resistance at the derating temperature.

    Examples
    --------
    >>> from haptorb import load
    >>> omni = load("omni")
    >>> omni.channels, omni.models
    (3, ('exact', 'point-coils', 'published'))
    """

    kind: ClassVar[DeviceKind]

    name: str
    title: str
    source: str
    coils: Coils
    supply: Supply
    limits: Limits
    assumed: Mapping[str, str]
    digest: str

    models: tuple[str, ...] = ()

    text: DeviceText | None = field(default=None, repr=False, compare=False)

    @property
    def tick_models(self) -> tuple[str, ...]:
        """Those of `models` that are fast enough for a servo. By default the first."""
        return self.models[:1]

    @property
    def channels(self) -> int:
        """Number of commanded currents."""
        return len(self.coils.names)

    @property
    def sensors(self) -> int:
        """Number of three-axis field sensors on the stator."""
        return 0

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remarks about inconsistent values of this device: sentences."""
        return ()

    @property
    def shell(self) -> Shell | None:
        """Where a tool can be above a dome; None for a device without a dome."""
        return None

    @property
    def is_upright(self) -> bool:
        """Whether a tool is upright if no orientation is given; else its axis is radial."""
        return False

    def check_hand_goals(self, places: Array, what: str) -> None:
        """Check where a scripted hand would lead the mover.

        By default anywhere within 1 m of the device's centre.

        Parameters
        ----------
        places : ndarray, shape (n, 3)
            Goals of the hand in the stator frame [m].
        what : str
            Origin of the values, for the message.

        Raises
        ------
        InputError
            For a place outside the workspace.
        """
        check_distance(places, what)

    @property
    def rest_position(self) -> Array:
        """(3,) rest position of the mover: a position at which every model of the device is valid [m]."""
        return np.zeros(3)

    @property
    def build_checks(self) -> tuple[BuildCheck, ...]:
        """Buildability checks of this device, with values and margins.

        Of any device: that its supply drives about the currents that it is limited to. Peaks in capabilities are those
        that it does drive (`driven_current`).
        """
        coils, supply = self.coils, self.supply
        cold = coils.resistance_at(np.full(self.channels, ROOM_TEMPERATURE_K))
        worst = int(np.argmax(coils.current_limit * cold))
        driven = format_quantity(float(supply.voltage / cold[worst]), "A")
        hot = format_quantity(float(supply.voltage / self.greatest_resistance[worst]), "A")
        return (
            BuildCheck(
                "current limits that the supply can drive", f"coil {coils.names[worst]}, coils.current_limit",
                float(coils.current_limit[worst]), _SURPLUS * float(supply.voltage / cold[worst]), "A",
                "leave coils.current_limit out (in a variant: drop it), or reduce it or the resistance",
                note=f"the supply drives {driven} at 20 °C, {hot} at the stop temperature",
            ),
        )  # fmt: skip

    @abstractmethod
    def wrench_map(self, state: State, model: str) -> WrenchMap:
        """Compute the wrench map at a pose; a kind of device implements this.

        Parameters
        ----------
        state : State
            Pose of the mover.
        model : str
            One of `models`.

        Returns
        -------
        WrenchMap
            `matrix` (6, m) [N/A, N·m/A] and `passive` (6,) [N, N·m].

        Raises
        ------
        GeometryError
            If a magnet would be inside a coil or the core.
        UnknownName
            If there is no such model.
        """

    def geometry(self) -> Geometry | None:
        """Return the bodies and places of the device, for drawings and the console.

        Returns
        -------
        Geometry or None
            The mover's parts are where it rests; None for a kind that does not state them.
        """
        return None

    @property
    def is_prepared(self) -> bool:
        """Whether nothing is left for `prepare` to compute."""
        return True

    def prepare(self, report: Callable[[int, int], None] | None = None) -> None:
        """Compute and cache expensive data, such as a motor's tables; most kinds have none.

        Parameters
        ----------
        report : callable, optional
            Receives the number of steps done, and of all.
        """

    def draw(self, view: str = "both", azimuth: float = 0.0) -> Figure:
        """Draw the device to scale, as `haptorb show` does.

        Parameters
        ----------
        view : str
            "section", "3d" or "both".
        azimuth : float
            Angle of the section's plane, which contains z, from +x towards +y [°].

        Returns
        -------
        matplotlib.figure.Figure
            The drawing; `figure.savefig(path)` stores it, and a notebook shows it.

        Raises
        ------
        InputError
            If the kind of device has no geometry.
        """
        from haptorb.devices.drawing import draw_geometry  # most programs draw nothing

        return draw_geometry(require_geometry(self, "`haptorb show`"), self.title, view, azimuth)

    def with_recorded_models(self, noted: tuple[str, ...]) -> Device:
        """Return the device with the models of a recording, in the order in which its rows count them.

        Parameters
        ----------
        noted : tuple of str
            Names of the models as the recording notes them; empty if it notes none.

        Returns
        -------
        Device
            The same device, unless the names of its models have changed since an earlier version.
        """
        return self

    def check_model(self, model: str) -> str:
        """`model` itself. Raises UnknownName with the models of this device."""
        if model not in self.models:
            raise UnknownName(f"model of device '{self.name}'", model, self.models)
        return model

    def check_tick_model(self, model: str) -> str:
        """`model` itself; UnknownName for no model of this device, InputError for one that takes longer than a tick."""
        if self.check_model(model) not in self.tick_models:
            raise InputError(
                f"model '{model}' of device '{self.name}' takes too long for a tick; a servo can use: "
                f"{', '.join(self.tick_models)}"
            )
        return model

    def _summarize(self) -> str:
        amperes = format_quantity(float(self.coils.current_limit.max()), "A")
        limits = f"{format_quantity(self.limits.force, 'N')}, {format_quantity(self.limits.torque, 'N·m')}"
        parts = f"{self.channels} channels to {amperes}, {self.sensors} field sensors, limits {limits}"
        return f"<{type(self).__name__} {self.name!r}: {parts}>"

    def _list_facts(self) -> list[tuple[str, str]]:
        """Facts common to all devices; kinds add their own."""
        coils, heat, limits = self.coils, self.coils.heat, self.limits
        few = self.channels <= 6
        names = ", ".join(coils.names) if few else f"{coils.names[0]} to {coils.names[-1]}"
        peak, lasting = float(coils.current_limit.max()), float(self.sustained_current.min())
        together = float(self.sustained_current_together.min())
        continuous = f"{format_quantity(lasting, 'A')} continuous"
        if heat.coupling is not None:
            continuous += f" in one coil, {format_quantity(together, 'A')} in all"
        power = "" if np.isinf(self.supply.power) else f", {format_quantity(self.supply.power, 'W')}"
        ohms = f"{format_number(float(coils.resistance.min()))} Ω at {coils.reference_temperature - 273.15:.0f} °C"
        return [
            ("title", self.title),
            ("source", self.source),
            ("channels", f"{self.channels} ({names})"),
            ("current", f"{format_quantity(peak, 'A')} peak, {continuous}"),
            ("coils", f"{ohms}, {format_quantity(float(coils.inductance.min()), 'H')}"),
            (
                "temperatures",
                f"currents reduced from {heat.derate - 273.15:.0f} °C, off at {heat.stop - 273.15:.0f} °C",
            ),
            ("supply", f"{format_quantity(self.supply.voltage, 'V')}{power}, {self.supply.duty_bits} bits of duty"),
            (
                "limits",
                f"{format_quantity(limits.force, 'N')}, {format_quantity(limits.torque, 'N·m')}, "
                f"{format_quantity(limits.slew, 'A/s')}, clients {format_quantity(limits.force_rate, 'N/s')}, "
                f"{format_quantity(limits.torque_rate, 'N·m/s')}, poses expire after "
                f"{format_quantity(limits.expiry, 's')}",
            ),
            ("field sensors", f"{self.sensors}, three axes each"),
            ("models", ", ".join(self.models)),
            ("assumed", f"{len(self.assumed)} values that the source does not state, see `.assumed`"),
            ("digest", self.digest[:12]),
        ]

    @property
    def driven_current(self) -> Array:
        """(m,) largest current that supply and limit allow, with the coils at their reference temperature [A]."""
        driven: Array = np.minimum(self.coils.current_limit, self.supply.voltage / self.coils.resistance)
        return driven

    @property
    def greatest_resistance(self) -> Array:
        """(m,) resistance of windings at the stop temperature, the maximum with current [Ω]."""
        return self.coils.resistance_at(np.full(self.channels, self.coils.heat.stop))

    @property
    def sustained_current(self) -> Array:
        """(m,) continuous current of a channel alone: its winding settles at the derating temperature
        [A]."""
        rise_per_ampere2 = np.diagonal(self._rise_per_ampere2)
        current: Array = np.minimum(np.sqrt(self._greatest_rise / rise_per_ampere2), self.coils.current_limit)
        return current

    @property
    def sustained_current_together(self) -> Array:
        """(m,) the same continuous current in all channels: the hottest winding settles at the derating temperature
        [A].

        At most `sustained_current`; equal to it without thermal coupling between equal channels.
        """
        hottest = float(self._rise_per_ampere2.sum(axis=1).max())
        current: Array = np.minimum(np.sqrt(self._greatest_rise / hottest), self.coils.current_limit)
        return current

    @property
    def _greatest_rise(self) -> float:
        return self.coils.heat.derate - self.coils.heat.ambient

    @property
    def _rise_per_ampere2(self) -> Array:
        """(m, m) [K/A²] steady rise of each winding (row) for the square of the current in each channel (column).

        All resistances as at the derating temperature: no winding is warmer, and few are as warm.
        """
        coils = self.coils
        rise: Array = coils.heat.network(self.channels).rise_per_watt * coils.resistance_at(
            np.full(self.channels, coils.heat.derate)
        )
        return rise


def require_geometry(device: Device, what: str) -> Geometry:
    """The geometry of `device` for a program `what`. Raises InputError for a kind that does not state it."""
    if (found := device.geometry()) is None:
        raise InputError(f"device '{device.name}' is a {device.kind.title}, which states no geometry: {what} needs it")
    return found


D = TypeVar("D", bound=Device)


def require(device: Device, of: type[D], what: str) -> D:
    """`device`, for a program `what` that supports only class `of`. Raises InputError for another.

    If several kinds support something in different ways, use a device function instead.
    """
    if not isinstance(device, of):
        raise InputError(f"device '{device.name}' is a {device.kind.title}; {what} works for {of.kind.title}s")
    return device


# --------------------------------------------------------------------------------------------------
# How long a channel may be loaded from cold before its winding reaches the temperature where currents are reduced.


def endurance(device: Device, shares: tuple[float, ...] = (1.0, 0.75, 0.5, 0.25)) -> tuple[tuple[float, float], ...]:
    """(share of full current, seconds until derating or inf) for the channel that heats fastest, alone."""
    coils, heat = device.coils, device.coils.heat
    # Of coils that warm no other the one that heats fastest is all there is to compute.
    model = heat.network(device.channels) if heat.coupling is not None else heat.network(1)
    cold = coils.resistance_at(np.full(device.channels, heat.ambient))
    alpha = coils.temperature_coefficient / resistance_ratio(
        coils.temperature_coefficient, coils.reference_temperature, heat.ambient
    )
    rows = []
    for share in shares:
        powers = (share * coils.current_limit) ** 2 * cold
        load = np.zeros(model.windings)
        load[int(np.argmax(powers)) if model.windings > 1 else 0] = powers.max()
        rows.append((share, model.time_to(heat.derate - heat.ambient, load, drive="current", coefficient=alpha)))
    return tuple(rows)
