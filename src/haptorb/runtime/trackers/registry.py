"""Registry of trackers: parses `--tracker` and prepares the feed, before anything starts.

pointer          the console's pointer        hall          the field sensors (the hand follows the pointer)
osc:PORT         OSC over UDP, this computer  osc:HOST:PORT beyond it, with a token
lsl:NAME[/SOURCE] a stream of this computer   replay:FILE   a recording's poses, simulated device only
natnet:HOST[:PORT][/BODY]                     a rigid body of an OptiTrack server

Formats follow a comma: osc:9000,vrchat  osc:9000,mine.toml  lsl:NAME,w-first (haptorb.runtime.trackers.formats).
"""

from __future__ import annotations

import os
import secrets
from abc import ABC, abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

from haptorb.arrays import whole_number
from haptorb.errors import DriverError, InputError, UnknownName, quote
from haptorb.runtime.drivers.registry import is_real
from haptorb.runtime.trackers.base import Feed

if TYPE_CHECKING:
    from haptorb.devices.base import Device
    from haptorb.estimation.tracker_frame import TrackerFrame

__all__ = [
    "TOKEN",
    "TRACKERS",
    "Preparation",
    "check_frame",
    "check_tracker",
    "feed_of",
    "has_feed",
    "is_tracker_name",
    "prepare_tracker",
]

TRACKERS = ("pointer", "hall")  #: hall: the hand follows the pointer, but its pose is measured by the field sensors
TOKEN = "HAPTORB_TRACKER_TOKEN"  #: environment variable with the token for senders on other computers

_FORMS = ("osc:PORT", "osc:HOST:PORT", "lsl:NAME", "replay:FILE", "natnet:HOST")
_MIN_TOKEN_LENGTH = 16  #: minimum length of a token, against guessing


def has_feed(name: str) -> bool:
    """Whether the tracker `name` has its own process.

    >>> has_feed("osc:9000"), has_feed("pointer")
    (True, False)
    """
    return name not in TRACKERS


def is_tracker_name(name: str) -> bool:
    """Whether `name` has the form of a tracker's name; its port, stream or file is not checked.

    >>> is_tracker_name("hall"), is_tracker_name("osc:9000"), is_tracker_name("osc")
    (True, True, False)
    """
    kind, separator, _ = name.partition(":")
    return not has_feed(name) or (kind in _KINDS and bool(separator))


def check_tracker(name: str, driver: str = "sim") -> str:
    """Return `name`; UnknownName or InputError if it is not a tracker, or not for `driver`. Nothing is opened."""
    if not has_feed(name):
        return name
    if not is_tracker_name(name):
        raise UnknownName("tracker", name, (*TRACKERS, *_FORMS))
    kind = _KINDS[name.partition(":")[0]]
    from haptorb.runtime.trackers.formats import FORMATS, split_format

    where, words = split_format(name.partition(":")[2])
    if name.startswith(("osc:", "natnet:")) and "," in where:  # names of LSL streams and files may have one
        raise UnknownName("format of tracker poses", where.rpartition(",")[2], FORMATS)
    kind(where)
    _check_format(name, kind, words)
    if kind is _Replay and is_real(driver):  # safety: replay-real
        raise InputError(
            f"tracker '{name}' replays recorded poses, but driver '{driver}' acts on the real tool: use replay with "
            "driver sim, or a tracker that measures the tool"
        )
    return name


def _check_format(name: str, kind: type[Preparation], words: tuple[str, ...]) -> None:
    """Raise InputError if `words` are not a format for this kind of tracker; reads a mapping file."""
    if kind is _Replay and words:
        raise InputError(f"tracker '{name}': a recording has poses in the stator's frame; leave out {words[0]}")
    from haptorb.runtime.trackers.formats import parse_format

    found, _ = parse_format(words)
    if found is not None and kind is not _Osc:
        raise InputError(f"tracker '{name}': {words[0]} is a format of OSC messages: use osc:PORT,{words[0]}")


class Preparation(ABC):
    """Resources of a feed, acquired before the servo starts.

    `spec` (plain JSON types) is passed to the feed's process, as is `descriptor`: an open socket, −1 if there is none.
    """

    token = ""  #: token that senders must send first; empty: none
    descriptor = -1
    spec: dict[str, Any]

    @abstractmethod
    def __init__(self, where: str) -> None:
        """Parse the text after the colon; InputError states what was expected."""

    @abstractmethod
    def make_ready(self) -> None:
        """Acquire the resources; DriverError or RecordingError states what is missing and what to do."""

    def close(self) -> None:
        """Release the resources once the feed's process has them."""
        if self.descriptor >= 0:
            os.close(self.descriptor)
            self.descriptor = -1


def prepare_tracker(name: str) -> Preparation:
    """Prepare the tracker `name` for its start."""
    from haptorb.runtime.trackers.formats import parse_format, split_format

    kind, _, rest = name.partition(":")
    where, words = split_format(rest)
    preparation = _KINDS[kind](where)
    found, conversions = parse_format(words)
    _check_installed(kind)
    preparation.make_ready()
    preparation.spec |= {"conversions": list(conversions), "format": found and found.spec}
    return preparation


def check_frame(frame: TrackerFrame, device: Device, tracker: str, driver: str = "sim") -> TrackerFrame:
    """Return `frame`; InputError or CalibrationError if it is not valid for `tracker` with `device`."""
    if not has_feed(tracker) or tracker.startswith("replay:"):
        raise InputError(
            f"tracker '{tracker}' already reports poses in the stator's frame; leave out the frame, which is for "
            "trackers with their own: osc, lsl, natnet"
        )
    if frame.simulated and is_real(driver):  # safety: frame-rehearsed
        raise InputError(
            f"the frame was registered in a rehearsal, driver '{driver}' moves a real device: register the real "
            f"tracker with `haptorb frame {device.name} --tracker {tracker}`"
        )
    return frame.check_for(device, tracker)


def feed_of(spec: dict[str, Any], descriptor: int, origin: Callable[[], float], frame: str = "") -> Feed:
    """Make the feed, in its process, with a transform by the text of `frame` if there is one.

    `origin` waits until the loop runs and returns the origin of its clock.
    """
    feed = _open_feed(spec, descriptor, origin)
    if conversions := spec.get("conversions"):
        from haptorb.runtime.trackers.formats import ConvertedFeed

        feed = ConvertedFeed(feed, conversions)
    if not frame:
        return feed
    from haptorb.estimation.tracker_frame import TrackerFrame
    from haptorb.runtime.trackers.base import FramedFeed

    return FramedFeed(feed, TrackerFrame.parse(frame, "the tracker's frame"))


def _open_feed(spec: dict[str, Any], descriptor: int, origin: Callable[[], float]) -> Feed:
    import socket

    match spec["kind"]:
        case "osc":
            from haptorb.runtime.trackers.formats import PoseFormat, make_reader
            from haptorb.runtime.trackers.osc_feed import OscFeed

            layout = spec.get("format")
            reader = make_reader(PoseFormat.of(layout)) if layout else None
            return OscFeed(socket.socket(fileno=descriptor), spec["token"], reader)
        case "lsl":
            from haptorb.runtime.trackers.lsl_feed import LslFeed

            return LslFeed(spec["name"])
        case "natnet":
            from haptorb.runtime.trackers.natnet_feed import NatNetFeed

            return NatNetFeed(socket.socket(fileno=descriptor), tuple(spec["version"]), spec["body"])
        case _:
            from haptorb.runtime.trackers.replay import ReplayFeed, load_poses

            rows = load_poses(spec["path"])
            return ReplayFeed(rows, origin())


def _check_installed(kind: str) -> None:
    package = {"osc": "pythonosc", "lsl": "pylsl", "natnet": "natnet"}.get(kind)
    try:
        if package:
            __import__(package)
    except (ImportError, OSError, RuntimeError) as cause:  # pylsl raises RuntimeError if its library is missing
        raise DriverError(
            f"tracker {kind} needs a package that is not installed ({cause}): pip install 'haptorb[trackers]'"
        ) from cause


def _port(text: str, form: str) -> int:
    port = whole_number(text)
    if port is None or not 1 <= port <= 65535:
        raise InputError(f"tracker must be {form} with a port from 1 to 65535; got port {quote(text)}")
    return port


@final
class _Osc(Preparation):
    def __init__(self, where: str) -> None:
        host, _, port = where.rpartition(":")
        self._host = host.strip("[]") or "127.0.0.1"
        self._port = _port(port, "osc:PORT or osc:HOST:PORT")

    def make_ready(self) -> None:
        from haptorb.runtime.trackers.osc_feed import loopback, osc_socket

        if not loopback(self._host):
            self.token = os.environ.get(TOKEN, "") or secrets.token_urlsafe(_MIN_TOKEN_LENGTH)
            if len(self.token) < _MIN_TOKEN_LENGTH:
                raise InputError(f"{TOKEN} must have at least {_MIN_TOKEN_LENGTH} characters; got {len(self.token)}")
        self.descriptor = osc_socket(self._host, self._port).detach()
        self.spec = {"kind": "osc", "token": self.token}


@final
class _Lsl(Preparation):
    def __init__(self, where: str) -> None:
        self._name = where
        if not where.strip():
            raise InputError("tracker must be lsl:NAME with the name of a stream; got none")

    def make_ready(self) -> None:
        from haptorb.runtime.trackers.lsl_feed import lsl_stream

        lsl_stream(self._name)
        self.spec = {"kind": "lsl", "name": self._name}


@final
class _Replay(Preparation):
    def __init__(self, where: str) -> None:
        self._path = Path(where).expanduser()
        if not where.strip():
            raise InputError("tracker must be replay:FILE with a recording; got none")

    def make_ready(self) -> None:
        from haptorb.runtime.trackers.replay import load_poses

        load_poses(self._path)
        self.spec = {"kind": "replay", "path": str(self._path.absolute())}


@final
class _NatNet(Preparation):
    def __init__(self, where: str) -> None:
        server, _, body = where.partition("/")
        self._host, _, port = server.partition(":")
        if not self._host or (body and not body.isdecimal()):
            raise InputError(
                f"tracker must be natnet:HOST, natnet:HOST:PORT or natnet:HOST/BODY, with the body's streaming id as a "
                f"number; got 'natnet:{where}'"
            )
        self._port = _port(port, "natnet:HOST:PORT") if port else 0
        self._body = int(body or 0)

    def make_ready(self) -> None:
        from haptorb.runtime.trackers.natnet_feed import PORT, natnet_socket

        connected, version = natnet_socket(self._host, self._port or PORT)
        self.descriptor = connected.detach()
        self.spec = {"kind": "natnet", "version": list(version), "body": self._body}


_KINDS: dict[str, type[Preparation]] = {"osc": _Osc, "lsl": _Lsl, "replay": _Replay, "natnet": _NatNet}
