"""Pose formats of other programs: VRChat, VMC, TUIO, Euler angles, other orders and axes, or by a mapping file.

A format follows the tracker: osc:9000,vrchat  osc:39539,vmc/SERIAL  osc:3333,tuio/7  osc:9000,euler-zyx
osc:9000,mine.toml. Every tracker accepts w-first and y-up: lsl:NAME,w-first  natnet:HOST,y-up.
"""

from __future__ import annotations

import math
import re
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, final

import numpy as np
from annotated_types import Len
from pydantic import AfterValidator, ValidationError

from haptorb.arrays import Array
from haptorb.devices.quantity import si
from haptorb.devices.schema import Form, Meaning, Section, Without, explain_mistakes
from haptorb.errors import InputError, UnknownName, quote
from haptorb.files import parse_toml, read_text
from haptorb.rotations import quaternion, rotation_of
from haptorb.runtime.trackers.base import Feed, RawPose, RejectedPose, TransformedFeed

__all__ = [
    "FORMATS",
    "ConvertedFeed",
    "FormatReader",
    "MappedReader",
    "MappingFile",
    "MessageLayout",
    "PoseFormat",
    "ReadPose",
    "TuioReader",
    "load_mapping",
    "make_reader",
    "parse_format",
    "split_format",
]

_NUMBERS = ("x", "y", "z", "qx", "qy", "qz", "qw", "rx", "ry", "rz", "time", "valid")
_POSITION, _QUATERNION, _ANGLES = ("x", "y", "z"), ("qx", "qy", "qz", "qw"), ("rx", "ry", "rz")
_AXES = {"x": 0, "y": 1, "z": 2}
_Y_UP = ("x", "-z", "y")  #: right-handed, y up
_UNITY = ("x", "z", "y")  #: left-handed, y up, z forward
_SURFACE = ("x", "-y", "z")  #: y down, as on a screen
_ROTATION = re.compile(r"(?!.*(.).*\1)([xyz]{3}|[XYZ]{3})")
_CONVERSIONS = ("w-first", "y-up")


# --------------------------------------------------------------------------------------------------
# Description of a format: the numbers of each message, and their conversion to metres and a quaternion with z up.


@dataclass(frozen=True)
class MessageLayout:
    """Layout of the messages to one address, in which `{object}` is replaced by the name of the tracked object.

    values  meaning of each value: x y z qx qy qz qw rx ry rz time valid object skip
    """

    address: str
    values: tuple[str, ...]


@dataclass(frozen=True)
class PoseFormat:
    """Format in which a program sends poses.

    messages  a pose is complete when each of them has been received
    tuio      instead: messages of TUIO 1.1
    lost      address of a message that reports the loss of the tool; "" if there is none
    object    name of the tracked object; "" if there is only one
    unit      length of a position of 1 [m]
    angle     size of an angle of 1 [rad]
    rotation  order of the angles: "zyx" about fixed axes, "ZYX" about the axes of the body
    axes      the sender's axes that are x, y and z of the stator: -z is its z reversed
    origin    position of the stator's origin in the sender's coordinates
    """

    messages: tuple[MessageLayout, ...] = ()
    tuio: bool = False
    lost: str = ""
    object: str = ""
    unit: float = 1.0
    angle: float = math.radians(1.0)
    rotation: str = "ZYX"
    axes: tuple[str, str, str] = ("x", "y", "z")
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def spec(self) -> dict[str, Any]:
        """As plain JSON types."""
        return asdict(self)

    @classmethod
    def of(cls, spec: Mapping[str, Any]) -> PoseFormat:
        """Make the format from its `spec`."""
        messages = tuple(MessageLayout(one["address"], tuple(one["values"])) for one in spec["messages"])
        return cls(**{**spec, "messages": messages, "axes": tuple(spec["axes"]), "origin": tuple(spec["origin"])})

    @property
    def matrix(self) -> Array:
        """Matrix (3, 3) from the sender's axes to the stator's; a reflection from left-handed ones."""
        return _make_matrix(self.axes)

    def convert(self, place: Sequence[float], turn: Array) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Convert to position [m] and quaternion (x, y, z, w) in the stator frame. place: as sent; turn (3, 3): matrix
        of the sent angles or quaternion."""
        M = self.matrix
        p = M @ ((np.asarray(place) - self.origin) * self.unit)
        return tuple(p.tolist()), tuple(quaternion(M @ turn @ M.T).tolist())


def _make_matrix(axes: Sequence[str]) -> Array:
    M = np.zeros((3, 3))
    for row, axis in enumerate(axes):
        M[row, _AXES[axis[-1]]] = -1.0 if axis.startswith("-") else 1.0
    return M


def _turn_of_quaternion(q: Sequence[float]) -> Array:
    """Rotation matrix of a quaternion (x, y, z, w), which is normalised."""
    numbers = np.array(q, dtype=np.float64)
    return rotation_of(numbers / np.linalg.norm(numbers))


#: angles of TUIO and Unity are about their own axes; the same formulas hold in left-handed axes
_VRCHAT = PoseFormat(
    messages=(
        MessageLayout("/tracking/trackers/{object}/position", _POSITION),
        MessageLayout("/tracking/trackers/{object}/rotation", _ANGLES),
    ),
    rotation="zxy", axes=_UNITY,
)  # fmt: skip
_VMC = PoseFormat(messages=(MessageLayout("/VMC/Ext/Tra/Pos", ("object", *_POSITION, *_QUATERNION)),), axes=_UNITY)
_TUIO = PoseFormat(tuio=True, angle=1.0, rotation="xyz", axes=_SURFACE, origin=(0.5, 0.5, 0.0))
KNOWN = {"vrchat": _VRCHAT, "vmc": _VMC, "tuio": _TUIO}
FORMATS = (*KNOWN, *_CONVERSIONS, "euler-zyx", "FILE.toml")  #: as listed in messages


def split_format(where: str) -> tuple[str, tuple[str, ...]]:
    """Split a tracker's argument into the part before the formats, and the formats.

    >>> split_format("9000,vrchat/1,y-up"), split_format("a, b")
    (('9000', ('vrchat/1', 'y-up')), ('a, b', ()))
    """
    rest, found = where, list[str]()
    while (parts := rest.rpartition(","))[1] and _is_format(parts[2]):
        rest, found = parts[0], [parts[2], *found]
    return rest, tuple(found)


def _is_format(word: str) -> bool:
    return (
        word in _CONVERSIONS
        or word.partition("/")[0] in KNOWN
        or word.startswith("euler-")
        or word.lower().endswith(".toml")
    )


def parse_format(words: Sequence[str]) -> tuple[PoseFormat | None, tuple[str, ...]]:
    """Parse `words`: the format, None for haptorb's own, and the conversions. Raises InputError."""
    found: PoseFormat | None = None
    for word in words:
        if word in _CONVERSIONS:
            continue
        if found is not None:
            raise InputError(f"a tracker has one format; got {', '.join(map(quote, words))}")
        name, _, chosen = word.partition("/")
        if name.startswith("euler-"):
            found = _make_euler(word.removeprefix("euler-"))
        elif word.lower().endswith(".toml"):
            found = load_mapping(Path(word).expanduser())
        else:
            found = replace(KNOWN[name], object=chosen)
    return found, tuple(word for word in _CONVERSIONS if word in words)


def _make_euler(order: str) -> PoseFormat:
    """Make the format of /haptorb/pose with x y z and three angles in degrees, in the order of `order`."""
    if not _ROTATION.fullmatch(order):
        raise UnknownName("order of angles", order, ("zyx", "ZYX", "xyz", "XYZ"))
    angles = tuple(f"r{axis.lower()}" for axis in order)
    return PoseFormat(
        messages=(MessageLayout("/haptorb/pose", (*_POSITION, *angles)),), lost="/haptorb/lost", rotation=order
    )


# --------------------------------------------------------------------------------------------------
# The mapping file, for programs that use another format.


def _check_axes(axes: tuple[str, ...]) -> tuple[str, ...]:
    if sorted(axis.removeprefix("-") for axis in axes) != ["x", "y", "z"]:
        raise ValueError(f"must name x, y and z once each, such as ['x', '-z', 'y']; got {list(axes)}")
    return axes


def _check_rotation(order: str) -> str:
    if not _ROTATION.fullmatch(order):
        raise ValueError(f"must be three different axes, 'zyx' or 'ZYX'; got {quote(order)}")
    return order


def _check_unit(kind: str, unit: str) -> Any:
    def check(text: str) -> str:
        si(text if text[:1].isdigit() else f"1 {text}", unit, kind)
        return text

    return AfterValidator(check)


class MessageSection(Section):
    """[[messages]]"""

    address: Annotated[
        str, Meaning("OSC address of the message"), Form("begins with /; {object} in it is the object's name")
    ]
    values: Annotated[
        tuple[Literal[(*_NUMBERS, "object", "skip")], ...],  # type: ignore[valid-type]
        Len(1, 40),
        Meaning(
            "what each value of the message is: position, quaternion, angles, time of measurement [s], 1 while seen"
        ),
        Form("x y z qx qy qz qw rx ry rz time valid, object (its name), skip (not used)"),
    ]


class MappingFile(Section):
    """A mapping file: describes the OSC messages that form a pose."""

    format: Annotated[
        Literal["vrchat", "vmc", "tuio"] | None,
        Meaning("known format that the other keys change"),
        Without("none: messages are listed"),
    ] = None
    object: Annotated[str, Meaning("name or number of the tracked object"), Without("there is only one")] = ""
    lost: Annotated[str, Meaning("address of a message that says that the tool is lost"), Without("none")] = ""
    unit: Annotated[
        str, _check_unit("a length", "m"), Meaning("length of a position of 1"), Form("a unit or a length: mm, 300 mm")
    ] = "m"
    angle: Annotated[
        str, _check_unit("an angle", "rad"), Meaning("size of an angle of 1"), Form("a unit of angles: deg, rad")
    ] = "deg"
    rotation: Annotated[
        str, AfterValidator(_check_rotation), Meaning("order of the rotations rx, ry, rz"),
        Form("zyx: about fixed axes, z first; ZYX: about the body's axes, z first"),
    ] = "ZYX"  # fmt: skip
    axes: Annotated[
        tuple[str, str, str] | None,
        AfterValidator(lambda axes: axes and _check_axes(axes)),
        Meaning("which of the sender's axes are x, y and z of the stator, z towards the summit"),
        Form("three of x, y, z, each perhaps with a minus"),
        Without("those of the format, else x, y, z"),
    ] = None
    origin: Annotated[
        tuple[float, float, float] | None,
        Meaning("position of the stator's origin as the sender counts"),
        Form("three numbers in `unit`"),
        Without("that of the format, else 0, 0, 0"),
    ] = None
    messages: Annotated[
        tuple[MessageSection, ...], Len(0, 10), Meaning("messages that make a pose; one pose needs all of them")
    ] = ()


def load_mapping(path: Path) -> PoseFormat:
    """Read a format from the mapping file `path`. Raises InputError that lists all mistakes."""
    text = read_text(path, "mapping file", InputError)
    try:
        raw = parse_toml(text)
        given = MappingFile.model_validate(raw)
    except ValidationError as cause:
        lines = [f"mapping file {path}: {line}" for line in explain_mistakes(cause.errors(), MappingFile)]
        raise InputError("\n".join(lines)) from cause
    except ValueError as cause:
        raise InputError(f"mapping file {path} is not a TOML file: {cause}") from cause
    found = KNOWN[given.format] if given.format else PoseFormat()
    if bool(given.messages) == bool(given.format):
        raise InputError(f"mapping file {path}: give [[messages]] or `format`, one of them")
    changes: dict[str, Any] = {"object": given.object, "lost": given.lost}
    if given.messages:
        changes["messages"] = tuple(MessageLayout(one.address, tuple(one.values)) for one in given.messages)
    if given.axes is not None:
        changes["axes"] = given.axes
    if given.origin is not None:
        changes["origin"] = given.origin
    for key, kind, unit in (("unit", "a length", "m"), ("angle", "an angle", "rad")):
        if key in given.model_fields_set:
            text = getattr(given, key)
            changes[key] = si(text if text[:1].isdigit() else f"1 {text}", unit, kind)
    if "rotation" in given.model_fields_set:
        changes["rotation"] = given.rotation
    found = replace(found, **changes)
    if not found.tuio:
        _check_complete(found, path)
    return found


def _check_complete(found: PoseFormat, path: Path) -> None:
    """Raise InputError unless all messages together have a position, and a quaternion or angles, each number once."""
    named = [value for one in found.messages for value in one.values if value not in ("skip", "object")]
    twice = sorted({value for value in named if named.count(value) > 1})
    if twice:
        raise InputError(f"mapping file {path}: {', '.join(twice)} comes twice")
    for part in (_POSITION, _QUATERNION, _ANGLES):
        missing = [value for value in part if value not in named]
        if missing and (part is _POSITION or len(missing) < len(part)):
            raise InputError(f"mapping file {path}: {', '.join(missing)} is in no message; {' '.join(part)} are needed")
    if {*_QUATERNION} <= {*named} and {*_ANGLES} <= {*named}:
        raise InputError(f"mapping file {path}: has a quaternion and angles; give one of them")
    if not {*_QUATERNION} <= {*named} and not {*_ANGLES} <= {*named}:
        raise InputError(f"mapping file {path}: has no orientation: name qx qy qz qw, or rx ry rz, in a message")


# --------------------------------------------------------------------------------------------------
# From messages to poses.


class ReadPose(NamedTuple):
    """Pose of the tracked object as read from messages.

    p, q        position [m] and quaternion in the stator's frame; empty if it is lost
    sent        its time of measurement on the sender's clock [s]; None if it has none
    resolution  of `sent` as it was transmitted [s]
    """

    p: tuple[float, ...]
    q: tuple[float, ...]
    valid: bool = True
    sent: float | None = None
    resolution: float = 0.0


class FormatReader(ABC):
    """Parses poses from the messages of successive datagrams."""

    remark = ""  #: why there is no pose, for the user; empty if there is no problem

    @abstractmethod
    def read(self, messages: Iterable[tuple[str, list[Any]]]) -> Iterator[ReadPose | RejectedPose]:
        """Yield each pose in `messages` (address, values), or rejected pose; messages on other subjects are ignored."""


def make_reader(layout: PoseFormat) -> FormatReader:
    """Make the reader of this format."""
    return TuioReader(layout) if layout.tuio else MappedReader(layout)


@dataclass
class _Known:
    """Values of one object that were received since its last pose."""

    numbers: dict[str, float] = field(default_factory=dict)
    fresh: set[str] = field(default_factory=set)  # addresses received
    resolution: float = 0.0


@final
class MappedReader(FormatReader):
    """Reader of a `layout`: a pose is complete when every message of it was received for its object."""

    def __init__(self, layout: PoseFormat) -> None:
        self._layout = layout
        self._messages = [(one, _compile_address(one.address)) for one in layout.messages]
        self._objects: dict[str, _Known] = {}
        self._other = ""

    def read(self, messages: Iterable[tuple[str, list[Any]]]) -> Iterator[ReadPose | RejectedPose]:
        """Yield each pose, or rejected pose."""
        for address, values in messages:
            if address == self._layout.lost:
                yield ReadPose((), (), valid=False)
                continue
            layout, found = next(
                ((one, match) for one, pattern in self._messages if (match := pattern.fullmatch(address))), (None, None)
            )
            if layout is None or found is None:
                if not self._objects:
                    self._other = (
                        f"a message {quote(address)[:80]} with {len(values)} values came; expected "
                        + ", ".join(f"{one.address} with {' '.join(one.values)}" for one, _ in self._messages)
                    )
                yield RejectedPose("other_message")
                continue
            yield from self._read_values(layout, found.groupdict().get("object", ""), values)

    def _read_values(self, layout: MessageLayout, name: str, values: list[Any]) -> Iterator[ReadPose | RejectedPose]:
        if len(values) != len(layout.values):
            self._other = (
                f"{layout.address} came with {len(values)} values; expected {len(layout.values)}, "
                f"{' '.join(layout.values)}"
            )
            yield RejectedPose("garbage")
            return
        numbers: dict[str, float] = {}
        resolution = 0.0
        for what, value in zip(layout.values, values, strict=True):
            if what == "object":
                name = str(value)
            elif what != "skip":
                if isinstance(value, bool):
                    value = int(value)
                if not isinstance(value, int | float):
                    self._other = f"{layout.address}: {what} is {type(value).__name__}, expected a number"
                    yield RejectedPose("garbage")
                    return
                numbers[what] = float(value)
                if what == "time":
                    resolution = float(getattr(value, "resolution", 0.0))
        self._other = ""
        if self._layout.object and name != self._layout.object:
            self._objects.setdefault(name, _Known()) if len(self._objects) < 64 else None
            yield RejectedPose("other_message")
            return
        known = self._objects.setdefault(name, _Known()) if len(self._objects) < 64 else _Known()
        known.numbers |= numbers
        known.fresh.add(layout.address)
        known.resolution = max(resolution, known.resolution)
        if len(known.fresh) == len(self._messages):
            known.fresh.clear()
            yield self._finish(known)

    def _finish(self, known: _Known) -> ReadPose | RejectedPose:
        numbers = known.numbers
        if not self._layout.object and len(self._objects) > 1:
            return ReadPose((), (), valid=False)
        if not all(math.isfinite(one) for one in numbers.values()):
            return RejectedPose("not_finite")
        if not numbers.get("valid", 1.0) > 0.5:
            return ReadPose((), (), valid=False)
        place = [numbers[one] for one in _POSITION]
        if "qx" in numbers:
            q = [numbers[one] for one in _QUATERNION]
            if abs(math.hypot(*q) - 1.0) > 0.1:
                return RejectedPose("no_rotation")
            turn = _turn_of_quaternion(q)
        else:
            turn = _turn_of_angles(self._layout, [numbers[one] for one in _ANGLES])
        p, orientation = self._layout.convert(place, turn)
        return ReadPose(p, orientation, True, numbers.get("time"), known.resolution)

    @property
    def remark(self) -> str:  # type: ignore[override]
        """Remark on the available objects if none or a missing one is chosen, or on an unknown message."""
        named = sorted(name for name in self._objects if name)
        listed = ", ".join(map(quote, named[:8])) + (" and more" if len(named) > 8 else "")
        if not self._layout.object and len(self._objects) > 1:
            return f"several objects send poses, {listed}: name one, such as FORMAT/{named[0]}"
        if self._layout.object and named and self._layout.object not in self._objects:
            return f"no pose of object {quote(self._layout.object)}; poses come of {listed}"
        waiting = [one for one in self._objects.values() if one.fresh]
        if waiting and not any("x" in one.numbers and ("qx" in one.numbers or "rx" in one.numbers) for one in waiting):
            return f"only {', '.join(sorted(waiting[0].fresh))} comes; a pose needs every message of its format"
        return self._other


def _compile_address(address: str) -> re.Pattern[str]:
    return re.compile(re.escape(address).replace(r"\{object\}", r"(?P<object>[^/]+)"))


def _turn_of_angles(layout: PoseFormat, angles: Sequence[float]) -> Array:
    """Rotation matrix of the angles rx, ry, rz in the layout's order."""
    from scipy.spatial.transform import Rotation

    about = dict(zip("xyz", angles, strict=True))
    ordered = [about[axis.lower()] * layout.angle for axis in layout.rotation]
    found: Array = Rotation.from_euler(layout.rotation, ordered).as_matrix()
    return found


@final
class TuioReader(FormatReader):
    """Reader of an object of TUIO 1.1: 2Dobj (x y a), 25Dobj (x y z a) or 3Dobj (x y z a b c), by its class id.

    A frame that lists the object as alive without its values means that it did not move: the last pose is current.
    """

    #: address → values of a `set` after session and class id that are used: place, then angles
    _LAYOUTS: ClassVar = {"/tuio/2Dobj": (2, 1), "/tuio/25Dobj": (3, 1), "/tuio/3Dobj": (3, 3)}

    def __init__(self, layout: PoseFormat) -> None:
        self._layout = layout
        self._sessions: dict[int, int] = {}  # session id → class id, of those alive
        self._last: ReadPose | None = None  # of the object
        self._other = ""

    def read(self, messages: Iterable[tuple[str, list[Any]]]) -> Iterator[ReadPose | RejectedPose]:
        """Yield the pose of the object in one frame."""
        alive: set[int] | None = None
        pose: ReadPose | RejectedPose | None = None
        other = True
        for address, values in messages:
            if address not in self._LAYOUTS:
                if not self._sessions:
                    self._other = f"a message {quote(address)[:80]} came; expected {', '.join(self._LAYOUTS)}"
                continue
            other = False
            match values:
                case ["alive", *sessions] if all(type(one) is int for one in sessions):
                    alive = set(sessions)
                case ["set", int(session), int(kind), *numbers]:
                    found = self._set(self._LAYOUTS[address], session, kind, numbers)
                    pose = found or pose
        if alive is not None:
            self._sessions = {one: kind for one, kind in self._sessions.items() if one in alive}
        if other:
            yield RejectedPose("other_message")
        elif isinstance(pose, RejectedPose):
            yield pose
        elif alive is not None or pose is not None:
            yield self._report(pose)

    def _set(
        self, layout: tuple[int, int], session: int, kind: int, numbers: list[Any]
    ) -> ReadPose | RejectedPose | None:
        if len(self._sessions) < 256:
            self._sessions[session] = kind
        if self._layout.object and str(kind) != self._layout.object:
            return None
        count, turns = layout
        if len(numbers) < count + turns or not all(isinstance(one, float | int) for one in numbers):
            return RejectedPose("garbage")
        used = [float(one) for one in numbers[: count + turns]]
        if not all(map(math.isfinite, used)):
            return RejectedPose("not_finite")
        place = [*used[:count], 0.0][:3]
        angles = used[count:] if turns == 3 else [0.0, 0.0, used[count]]
        return ReadPose(*self._layout.convert(place, _turn_of_angles(self._layout, angles)))

    def _report(self, pose: ReadPose | None) -> ReadPose:
        kinds = {
            kind for kind in self._sessions.values() if not self._layout.object or str(kind) == self._layout.object
        }
        if len(kinds) != 1:
            self._last = None
            return ReadPose((), (), valid=False)
        self._last = pose or self._last
        return self._last or ReadPose((), (), valid=False)

    @property
    def remark(self) -> str:  # type: ignore[override]
        """Remark on the available objects if none is chosen or the chosen one is not on the surface."""
        kinds = sorted(set(self._sessions.values()))
        listed = ", ".join(map(str, kinds[:8]))
        if not self._layout.object and len(kinds) > 1:
            return f"several objects are there, {listed}: name one, such as tuio/{kinds[0]}"
        if self._layout.object and kinds and self._layout.object not in map(str, kinds):
            return f"object {self._layout.object} is not there; {listed} are"
        return self._other


# --------------------------------------------------------------------------------------------------
# Conversions of a whole feed: quaternions with w first, axes with y up.


@final
class ConvertedFeed(TransformedFeed):
    """Converts a feed with quaternions with w first, or with its y axis up; a pose that cannot be converted is passed
    on unchanged, for the filter to reject."""

    def __init__(self, feed: Feed, conversions: Sequence[str]) -> None:
        super().__init__(feed)
        self._w_first = "w-first" in conversions
        self._format = PoseFormat(axes=_Y_UP) if "y-up" in conversions else None

    def transform(self, pose: RawPose) -> RawPose:
        """Return the pose in haptorb's order and axes."""
        if len(pose.p) != 3 or len(pose.q) != 4:
            return pose
        p: tuple[float, ...] = pose.p
        q: tuple[float, ...] = (*pose.q[1:], pose.q[0]) if self._w_first else pose.q
        if self._format is not None and all(map(math.isfinite, (*p, *q))) and abs(math.hypot(*q) - 1.0) < 0.1:
            p, q = self._format.convert(p, _turn_of_quaternion(q))
        return pose._replace(p=p, q=q)
