"""The servers of a run as the program holds them that runs the servo: prepare, start, watch, end."""

from __future__ import annotations

import contextlib
import errno
import ipaddress
import json
import os
import re
import secrets
import shutil
import socket
import subprocess
import tempfile
import threading
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from time import monotonic, process_time, sleep
from types import TracebackType
from typing import Any, Literal, Protocol, Self, cast, final
from urllib.parse import urlsplit

from haptorb.arrays import Array, record
from haptorb.cluster import pack
from haptorb.devices.base import Device
from haptorb.errors import DriverError, HaptorbError, InputError, UnknownName
from haptorb.runtime.linux import end_process, is_parent_gone, run_uninterrupted
from haptorb.runtime.liveness import HangWatch
from haptorb.runtime.prestart import start_module
from haptorb.runtime.servo import Servo
from haptorb.runtime.shared_memory import BUTTONS, Phase, SharedMemory, TextSlot, Word
from haptorb.runtime.sockets import is_own_account, tcp_owner
from haptorb.runtime.world_output import show
from haptorb.version import __version__
from haptorb.worlds import Remote
from haptorb.worlds.base import World
from haptorb.worlds.dynamic import HOLD
from haptorb.worlds.scene import SceneFile
from haptorb.worlds.user_world import FileWithRemote, WorldFile

__all__ = [
    "KINDS",
    "LATE",
    "LOOPBACK",
    "OTHER_LOOPBACK",
    "SILENCE",
    "TOKEN",
    "Access",
    "KindModule",
    "ServedDevice",
    "ServerChoice",
    "ServerKind",
    "ServerPreparation",
    "ServerPriority",
    "Serving",
    "add_client_force",
    "check_port",
    "check_servers",
    "choose_serve_token",
    "describe_servers",
    "has_other_loopback",
    "is_client_force_alone",
    "is_loopback",
    "is_own_connection",
    "load_kind",
    "open_port",
    "port_owner",
]


# --------------------------------------------------------------------------------------------------
# The running device as a server's process sees it: its rows, who may command it, and its clients' news.


SILENCE = 2.0  #: a client that holds the device and commands nothing for so long has let it go [s]
LATE = 1.0  #: what a client asked longer ago, while its server did not read, is not done any more [s]
_SESSIONS = 10_000  #: numbers of sessions that one server has for itself
_MAX_COMMANDED_FORCE_N = 1e6  #: of a commanded force [N]; the world and the guard have their own limits, far below


@final
class ServedDevice:
    """For the server with the number `slot`, in the memory `shared` of a loop that the process `parent` started.

    device   the running device
    facts    of the run: driver, tracker, estimator, model, rate_hz, modes, versions
    dropped  rows that this server was too slow to read
    busy     how often a client was refused because another one holds the device
    stale    commands that were refused because they had waited for this server
    """

    def __init__(self, shared: SharedMemory, slot: int, parent: int, device: Device, facts: Mapping[str, Any]) -> None:
        self.device, self.facts, self.layout = device, dict(facts), shared.layout
        self.dropped = self.busy = self.stale = 0
        self.ending = False  #: set when this server is to end
        self._shared, self._slot, self._parent = shared, slot, parent
        self._block = shared.force_block(slot)
        self._cursor = shared.ring.count
        self._sessions = _SESSIONS * slot
        self._holder, self._held_since = 0, 0.0
        self._facts: dict[str, Any] = {}  # as reported last
        self._world_number, self._renders = -1, False

    @property
    def over(self) -> bool:
        """Whether the server is to end: the servo has ended, or no reader is left."""
        words = self._shared.words
        return bool(self.ending or words[Word.QUIT] or words[Word.PHASE] >= Phase.ENDED or is_parent_gone(self._parent))

    @property
    def origin(self) -> float:
        """The computer's monotonic clock when the loop's clock, `t` of the rows, was zero [s]."""
        return float(self._shared.words[Word.ORIGIN]) * 1e-9

    def latest(self) -> Array | None:
        """(width,) the newest row, in the units of `layout`; None before the first."""
        return self._shared.ring.latest()

    def read_rows(self) -> Array:
        """(n, width) what the loop published since the last call, oldest first; what was lost is counted in
        `dropped`. In the units [..] of `layout`; never waits."""
        before = self._cursor
        self._cursor, rows = self._shared.ring.read_since(before)
        self.dropped += self._cursor - before - len(rows)
        return rows

    @property
    def tick_count(self) -> int:
        """Rows published so far: another number is another newest row."""
        return int(self._shared.ring.count)

    @property
    def world(self) -> dict[str, Any]:
        """The world that is rendered: `name`, `values`, and the `memory` fields that its rows have; empty before the
        first."""
        changes = self._shared.worlds_since(self._shared.words[Word.WORLD] - 1)
        return dict(json.loads(changes[-1][1])) if changes else {}

    @property
    def renders_force(self) -> bool:
        """Whether the world that is felt now has the clients' force in it; a person may have chosen another."""
        number = int(self._shared.words[Word.WORLD])
        if number != self._world_number:
            names = [field["name"].rpartition("_")[2] for field in self.world.get("memory", [])]
            self._world_number, self._renders = number, {"force", "session", "fade"} <= set(names)
        return self._renders

    @property
    def buttons(self) -> dict[str, bool]:
        """Which of the buttons a, b, c a person or a scripted hand holds down."""
        bits = self.button_bits
        return {name: bool(bits >> i & 1) for i, name in enumerate(BUTTONS)}

    @property
    def button_bits(self) -> int:
        """The same as bits, a the first."""
        return int(self._shared.words[Word.BUTTONS]) | self._shared.hand.buttons

    @property
    def grip(self) -> float:
        """The opening of a scripted hand's gripper [m]; NaN without one."""
        return self._shared.hand.grip

    def open_session(self) -> int:
        """A number for a new client, which no other client of this run has."""
        self._sessions += 1
        return self._sessions

    @property
    def holder(self) -> int:
        """Session of the client that holds the device; 0: none."""
        if self._holder and monotonic() - self._held_since > SILENCE:
            self._holder = 0
        return self._holder

    def command(self, session: int, force: Sequence[float], *, arrival: float | None = None, mapping: int = 0) -> bool:
        """The client `session` wants `force` (3,) [N], in the stator's frame, since `arrival` of its message on the
        monotonic clock [s]; None: now. False, and nothing happens, if another client holds the device, if the numbers
        are not finite, or if the message has waited for longer than a command lasts.

        No force takes no device: many programs that only watch send zeros, because each message is answered.
        """
        if self.holder != session and not any(force):
            return True
        if self.holder not in (0, session):  # safety: watcher-commands-nothing
            self.busy += 1
            return False
        if not all(
            -_MAX_COMMANDED_FORCE_N <= number <= _MAX_COMMANDED_FORCE_N for number in force
        ):  # safety: served-force-finite
            return False
        now = monotonic()
        since = now if arrival is None else min(arrival, now)
        if now - since > HOLD:  # safety: waited-is-stale
            self.stale += 1
            return False
        self._holder, self._held_since = session, since
        self._block.command(force, session, since, mapping)
        return True

    def lose(self, session: int) -> None:
        """The connection of the client `session` was lost: if it holds the device, its force ends and others may."""
        if self._holder == session:
            self._holder = 0
            self._block.lose(monotonic())  # safety: lost-client-told

    def request_world(self, name: str, values: Mapping[str, Any]) -> None:
        """Ask the program that runs the servo for the world `name` with `values`; the newest counts, others that
        were not read yet are dropped."""
        self._shared.server_requests[self._slot].write(json.dumps({"name": name, "values": dict(values)}, default=list))

    def report(self, server: str, address: str, clients: Sequence[Mapping[str, Any]], **more: Any) -> None:
        """Tell people who is connected: each of `clients` has `name`, `session`, `rate_hz` and `holds`. At most four
        times a second, please; of more than 50 clients the rest is only counted."""
        facts = {
            "server": server, "address": address, "count": len(clients), "clients": list(clients[:50]),
            "dropped": self.dropped, "stale": self.stale, **more,
        }  # fmt: skip
        self._facts = facts
        self._shared.server_facts[self._slot].write(json.dumps(facts))

    def conclude(self) -> None:
        """This server has ended: no client is connected any more; its counts stay for the run's report."""
        if self._facts:
            self._facts |= {"count": 0, "clients": [], "dropped": self.dropped}
            self._shared.server_facts[self._slot].write(json.dumps(self._facts))


# --------------------------------------------------------------------------------------------------
# What a server needs, found and opened before the servo starts: its ports above all.


@dataclass
class ServerPreparation:
    """spec         the settings of the server's process, plain JSON types
    descriptors  open sockets that it inherits, in order; closed here once it has them
    address      where programs find it, for people
    remarks      what a person must know beside: a token, say
    """

    spec: dict[str, Any]
    address: str
    descriptors: list[int] = field(default_factory=list)
    remarks: tuple[str, ...] = ()

    def close(self) -> None:
        """The server's process has its sockets, or they are closed. May be called twice."""
        while self.descriptors:
            os.close(self.descriptors.pop())


# --------------------------------------------------------------------------------------------------
# The kinds of servers that `--serve` knows; adding one is a module and a line here.


@record
class ServerKind:
    """What is known of a kind before its module is loaded.

    form     how it is written behind --serve
    module   that has its `prepare` and `serve`, see `KindModule`
    package  that must be installed for it; empty: none
    world    what becomes of the world: "alone": without --world, the clients' force is all that is felt; "added": the
             clients' force is added to the current world; "unchanged": its clients command no force
    """

    form: str
    module: str
    package: str
    world: Literal["alone", "added", "unchanged"]


class KindModule(Protocol):
    """The two functions that a kind's module has."""

    def prepare(self, where: str) -> ServerPreparation:
        """In the program that starts the servo: understand `where`, what stands behind the colon of --serve, and open
        its ports. InputError says what was expected."""

    def serve(self, spec: dict[str, Any], descriptors: list[int], served: ServedDevice) -> None:
        """In the server's own process: serve with the `spec` and the open `descriptors` of the preparation, until
        `served.over`."""


#: name before the colon of --serve → kind
KINDS: dict[str, ServerKind] = {
    "haply": ServerKind("haply[:HOST][:PORT[:EVENTS]]", "haptorb.serve.haply", "", "alone"),
    "osc": ServerKind("osc[:[HOST:]PORT]", "haptorb.serve.osc", "pythonosc", "added"),
    "lsl": ServerKind("lsl", "haptorb.serve.lsl", "pylsl", "unchanged"),
    "foxglove": ServerKind("foxglove[:PORT]", "haptorb.serve.foxglove", "foxglove", "unchanged"),
    "native": ServerKind("native[:SCALE]", "haptorb.serve.native", "", "alone"),
}


def load_kind(name: str) -> KindModule:
    """The module of the kind `name`. Raises DriverError if the package that it needs is not installed."""
    kind = KINDS[name]
    try:
        if kind.package:
            import_module(kind.package)
    except (ImportError, OSError, RuntimeError) as cause:  # pylsl says RuntimeError when its library is missing
        raise DriverError(
            f"--serve {name} needs a package that is not installed ({cause}): pip install 'haptorb[serve]'"
        ) from cause
    return cast("KindModule", import_module(kind.module))


# --------------------------------------------------------------------------------------------------
# From the options `--serve KIND[:...]` to servers that are prepared, and to the world that is felt with them.


@record
class ServerChoice:
    """One `--serve`: the `kind`, and what stands behind its colon."""

    kind: str
    where: str


def check_servers(texts: Sequence[str]) -> tuple[ServerChoice, ...]:
    """What the options `texts` ask for; nothing is opened.

    Raises UnknownName for a kind that there is not, InputError for two of one kind.

    >>> check_servers(["haply:10001:10020"])
    (ServerChoice(kind='haply', where='10001:10020'),)
    """
    found: dict[str, ServerChoice] = {}
    for text in texts:
        kind, _, where = text.partition(":")
        if kind not in KINDS:
            raise UnknownName("server", kind, [one.form for one in KINDS.values()])
        if kind in found:
            raise InputError(
                f"--serve {kind} was given twice: a run has one server of a kind, for any number of clients"
            )
        found[kind] = ServerChoice(kind, where)
    return tuple(found.values())


def is_client_force_alone(choices: Sequence[ServerChoice]) -> bool:
    """Whether, without --world, the clients' force is all that is felt."""
    return any(KINDS[choice.kind].world == "alone" for choice in choices)


def add_client_force(
    world: World | WorldFile | SceneFile, choices: Sequence[ServerChoice]
) -> World | FileWithRemote | WorldFile | SceneFile:
    """`world` with the force of the clients of these servers, if one of them has clients that command forces; a file
    keeps it whenever it is loaded again."""
    if isinstance(world, Remote) or all(KINDS[choice.kind].world == "unchanged" for choice in choices):
        return world
    return FileWithRemote(world) if isinstance(world, WorldFile | SceneFile) else world + Remote()


_START = 30.0  #: longest wait for a server's process [s]
_HUNG = 4.0  #: without processor time, after which a server that starts hangs [s]
_FINISH = 1.5  #: for all of them to end on request before they are killed [s]
_ABOVE = 0.002  #: the dome, where a tool that is not held otherwise is held [m]
_REQUEST_CHECK_INTERVAL_S = 0.02  #: between two looks for what servers request [s]


@final
class _Server:
    def __init__(self, choice: ServerChoice, number: int) -> None:
        self.choice, self.number = choice, number
        self.preparation: ServerPreparation = load_kind(choice.kind).prepare(choice.where)
        self.process: subprocess.Popen[bytes] | None = None
        self.request_version = 0  # version of the last request
        self.reported_end = False  # that its process has ended


@final
class Serving:
    """The servers `choices` for `servo`. Their ports are opened at once; `start` follows when the servo runs.

    Raises InputError for an address that cannot be had, DriverError for a package that is not installed.
    """

    def __init__(self, choices: Sequence[ServerChoice], servo: Servo) -> None:
        self._servo, self._servers = servo, list[_Server]()
        self._ending = threading.Event()
        self._watcher: threading.Thread | None = None
        self._folder: Path | None = None
        try:
            for number, choice in enumerate(choices):
                self._servers.append(_Server(choice, number))
        except BaseException:
            self.end()
            raise

    @property
    def lines(self) -> list[str]:
        """Where programs find each server, one line each, and what people must know beside."""
        return [
            line
            for one in self._servers
            for line in (f"{one.choice.kind}: {one.preparation.address}", *one.preparation.remarks)
        ]

    def start(self) -> None:
        """Start the servers' processes; returns when all of them serve. Raises DriverError with the reason if one
        does not."""
        if not self._servers:
            return
        self._folder = Path(tempfile.mkdtemp(prefix="haptorb-serve-"))
        shared = SharedMemory(self._servo.memory_path)
        for one in self._servers:
            self._start_process(one)
        deadline = monotonic() + _START
        for one in self._servers:
            assert one.process is not None
            watch, hung = HangWatch(one.process.pid), 0.0
            while shared.words[Word.SERVERS + one.number] == Phase.STARTING:
                hung = watch.look()
                if one.process.poll() is not None or monotonic() > deadline or hung > _HUNG:
                    break
                sleep(0.002)
            if shared.words[Word.SERVERS + one.number] != Phase.RUNNING:
                why = f"its process did nothing for {hung:.0f} s and was ended" if hung > _HUNG else ""
                raise DriverError(f"--serve {one.choice.kind} did not start: {why or self._explain_end(one)}")
            one.preparation.close()
        self._watcher = threading.Thread(target=self._watch, args=(shared,), name="haptorb-servers", daemon=True)
        self._watcher.start()

    def hold_tool(self) -> None:
        """Without a console no hand holds a simulated tool: it is held at rest, so that clients have a cursor."""
        servo = self._servo
        free = servo.driver == "sim" and servo.config.hand is None and servo.tracker in ("pointer", "hall")
        if self._servers and free:
            shell = servo.device.shell
            rest = servo.device.rest_position
            servo.hand.hold(rest if shell is None else (0.0, 0.0, shell.contact_distance + _ABOVE))

    def _start_process(self, one: _Server) -> None:
        servo, prepared = self._servo, one.preparation
        spec = {
            "shared": str(servo.memory_path),
            "slot": one.number,
            "parent": os.getpid(),
            "kind": one.choice.kind,
            "given": prepared.spec,
            "descriptors": prepared.descriptors,
            "device": servo.device,
            "facts": describe_run(servo),
        }
        one.process = start_module(
            "haptorb.serve.server_process",
            errors=self._errors(one), stdin=subprocess.PIPE, descriptors=tuple(prepared.descriptors),
        )  # fmt: skip
        assert one.process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # it has ended already: `start` reports why
            one.process.stdin.write(pack(spec))
            one.process.stdin.close()

    def _errors(self, one: _Server) -> Path:
        assert self._folder is not None
        return self._folder / f"{one.choice.kind}.txt"

    def _explain_end(self, one: _Server) -> str:
        text = ""
        with contextlib.suppress(OSError):
            text = self._errors(one).read_text(errors="replace")[-2000:].strip()
        code = None if one.process is None else one.process.poll()
        return text or ("no answer" if code is None else f"its process ended with code {code}")

    def _watch(self, shared: SharedMemory) -> None:
        """Do what servers request, and tell people of one that ended."""
        while not self._ending.wait(_REQUEST_CHECK_INTERVAL_S):
            for one in self._servers:
                self._take_request(one, shared.server_requests[one.number])
                over = one.process is not None and one.process.poll() is not None
                if over and self._servo.alive and not one.reported_end:
                    one.reported_end = True
                    show(f"--serve {one.choice.kind} ended, the servo continues: {self._explain_end(one)}\n")

    def _take_request(self, one: _Server, requests: TextSlot) -> None:
        if requests.version == one.request_version:
            return
        one.request_version, text = requests.read()
        if not text:
            return
        try:
            request = json.loads(text)
            self._servo.set_world(request["name"], request["values"])
        except HaptorbError as cause:
            show(f"--serve {one.choice.kind}: a client's command was refused: {cause}\n")

    def end(self) -> None:
        """End all servers, by force if they do not end by themselves. May be called twice."""
        self._ending.set()
        run_uninterrupted(self._end_all)

    def _end_all(self, _: threading.Event) -> None:
        if self._watcher is not None:
            self._watcher.join(_FINISH)
            self._watcher = None
        running = [one for one in self._servers if one.process is not None and one.process.poll() is None]
        for one in running:
            one.process.terminate()  # type: ignore[union-attr]
        deadline = monotonic() + _FINISH
        for one in running:
            if not end_process(one.process, max(deadline - monotonic(), 0.0)):
                kind, number = one.choice.kind, one.process.pid  # type: ignore[union-attr]
                show(f"--serve {kind} cannot be ended: the kernel holds its process {number}\n")
        for one in self._servers:
            one.preparation.close()
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)
            self._folder = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.end()


def describe_run(servo: Servo) -> dict[str, Any]:
    """What a server's process needs to know of the run, plain JSON types."""
    return {
        "driver": servo.driver,
        "tracker": servo.tracker,
        "estimator": servo.estimator,
        "model": servo.model,
        "rate_hz": servo.rate,
        "modes": list(servo.modes),
        "haptorb": __version__,
    }


# --------------------------------------------------------------------------------------------------
# Ports of servers: opened with an error that says who has them and what to do.


LOOPBACK, OTHER_LOOPBACK = "127.0.0.1", "::1"
_QUEUE = 128  #: connections that may wait to be taken
_UNREAD = 262144  #: bytes that the system keeps for a client that is slow


def check_port(text: str, form: str) -> int:
    """The port that `text` says, 0 to 65535 (0: any free one). InputError names the `form` of the option.

    >>> check_port("10001", "foxglove[:PORT]")
    10001
    """
    if not (text.isascii() and text.isdecimal() and int(text) <= 65535):
        raise InputError(f"--serve {form}: a port is a whole number from 0 to 65535; got '{text}'")
    return int(text)


def is_loopback(host: str) -> bool:
    """Whether only programs of this computer reach `host`.

    >>> is_loopback("localhost"), is_loopback("127.0.0.1"), is_loopback("::1"), is_loopback("0.0.0.0")
    (True, True, True, False)
    """
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def has_other_loopback() -> bool:
    """Whether this computer answers at ::1."""
    with suppress(OSError), socket.socket(socket.AF_INET6, socket.SOCK_STREAM) as probe:
        probe.bind((OTHER_LOOPBACK, 0))
        return True
    return False


def open_port(port: int, option: str, *, host: str = LOOPBACK, datagrams: bool = False) -> socket.socket:
    """A socket on `port` of `host`, listening unless it is for `datagrams`.

    Raises InputError that says which program has the port, and the `option` that takes another.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    found = socket.socket(family, socket.SOCK_DGRAM if datagrams else socket.SOCK_STREAM)
    try:
        if not datagrams:
            found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            found.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _UNREAD)
        found.bind((host, port))
        if not datagrams:
            found.listen(_QUEUE)
    except OSError as cause:
        found.close()
        if cause.errno == errno.EADDRINUSE:
            owner = port_owner(port, datagrams=datagrams) or "another program"
            raise InputError(
                f"port {port} of {host} is in use by {owner}: end it, or choose another port with {option} (0 takes "
                "any free one)"
            ) from cause
        raise InputError(
            f"port {port} of {host} cannot be opened: {cause.strerror or cause}; choose another with {option}"
        ) from cause
    return found


def port_owner(port: int, *, datagrams: bool = False) -> str:
    """Which program has `port`, as "NAME (process ID)"; empty if that cannot be seen: it is another account's."""
    kind = "udp" if datagrams else "tcp"
    nodes = _port_nodes(port, kind) | _port_nodes(port, f"{kind}6")
    links = {f"socket:[{node}]" for node in nodes}
    for process in Path("/proc").glob("[0-9]*") if links else ():
        with suppress(OSError):
            for descriptor in (process / "fd").iterdir():
                with suppress(OSError):
                    if str(descriptor.readlink()) in links:
                        return f"{(process / 'comm').read_text().strip()} (process {process.name})"
    return ""


def _port_nodes(port: int, table: str) -> set[str]:
    """The inodes of the sockets bound to `port` in one of the kernel's tables."""
    found = set()
    with suppress(OSError):
        for line in Path(f"/proc/net/{table}").read_text().splitlines()[1:]:
            words = line.split()
            bound = int(words[1].rpartition(":")[2], 16) == port
            if bound and (table.startswith("udp") or words[3] == "0A"):  # 0A: listening
                found.add(words[9])
    return found


# --------------------------------------------------------------------------------------------------
# Who may connect: programs and pages of this account on this computer; all others only with the token of this run.


TOKEN = "HAPTORB_SERVE_TOKEN"  #: of the environment: a token that stays the same from one start to the next

_SHORTEST = 16  #: a token that cannot be guessed [characters]
_SHAPE = re.compile(r"[A-Za-z0-9_-]*")


def choose_serve_token(host: str) -> str:
    """What clients beyond this account must show: the one in the environment's HAPTORB_SERVE_TOKEN, else a new one;
    empty, and only this account may connect, without it for a `host` that only this computer reaches.

    Raises InputError if the given one cannot be one.
    """
    given = os.environ.get(TOKEN, "")
    if not given:
        return "" if is_loopback(host) else secrets.token_urlsafe(_SHORTEST)
    if len(given) < _SHORTEST or not _SHAPE.fullmatch(given):
        raise InputError(f"{TOKEN} must have at least {_SHORTEST} letters, digits, - or _; got {len(given)} characters")
    return given


@final
class Access:
    """The rules of one server with its `token`; empty: only programs of this account use it.

    A page of another site could otherwise open a WebSocket to this computer (browsers let it) and move the device: its
    Origin stops it. One that has its own name resolved to 127.0.0.1 is stopped by Host.
    """

    def __init__(self, token: str = "") -> None:
        self._token = token

    def refuse(self, peer: str, headers: Mapping[str, str], target: str, *, own: bool) -> str:
        """Why a request from the address `peer` for `target` may not come in; empty if it may.

        headers: their names in lower case; own: a program of this account on this computer has the connection.
        """
        near = is_loopback(peer)
        origin = headers.get("origin")
        if origin is not None and not _is_local_origin(origin):  # safety: serve-origin
            return f"pages of '{origin[:100]}' may not use this server; open the page from this computer"
        host = headers.get("host", "")
        if near and not is_loopback(_host_of(host)):  # safety: serve-host
            return f"programs of this computer reach this server as localhost or 127.0.0.1, not as '{host[:100]}'"
        if self._is_authorized(headers, target):
            return ""
        if near and own:  # safety: serve-account
            return ""
        if near:
            return (
                "this server is for programs of the account that runs the servo; another account needs the token "
                f"that was set with {TOKEN}, as ?token=TOKEN or as header 'Authorization: Bearer TOKEN'"
            )
        return (
            "from another computer this server needs the token that `haptorb run` printed: as header "
            "'Authorization: Bearer TOKEN', or in the address as ?token=TOKEN"
        )

    def _is_authorized(self, headers: Mapping[str, str], target: str) -> bool:
        if not self._token:
            return False
        tokens = [headers.get("authorization", "").removeprefix("Bearer ")]
        query = target.partition("?")[2].split("&")
        tokens += [one.removeprefix("token=") for one in query if one.startswith("token=")]
        return any(secrets.compare_digest(one.encode(), self._token.encode()) for one in tokens[:2])


def is_own_connection(peer: Sequence[Any] | None, own: Sequence[Any] | None) -> bool:
    """Whether a program of this account on this computer has the other end of a TCP connection, from the address `peer`
    (host, port) to `own`."""
    if not peer or not own or not is_loopback(str(peer[0])):
        return False
    return is_own_account(tcp_owner((peer[0], peer[1]), (own[0], own[1])))


def _host_of(authority: str) -> str:
    """The host in `host:port`, lower case, without a final dot."""
    host = authority.rsplit(":", 1)[0] if not authority.endswith("]") and ":" in authority else authority
    return host.lower().rstrip(".")


def _is_local_origin(origin: str) -> bool:
    """Whether a page with this Origin comes from this computer, through whichever port."""
    try:
        return is_loopback(urlsplit(origin).hostname or "")
    except ValueError:
        return False


# --------------------------------------------------------------------------------------------------
# Before ordinary programs while it sleeps nearly always: an answer should not wait for its turn on a processor.


_URGENT = -10  #: niceness; every loop goes before, and so does the console's page
_FLOOD = 0.6  #: of a processor: who needs more is flooded, and takes its turn like any other
_CALM = 0.4  #: and comes first again below


@final
class ServerPriority:
    """Of this process; `look` at it now and then."""

    def __init__(self) -> None:
        self._time, self._used = monotonic(), process_time()
        self._urgent = self._ask(_URGENT)

    def look(self) -> None:
        """Give way if clients keep the processor busy, come first again when they do not."""
        now, used = monotonic(), process_time()
        share = (used - self._used) / max(now - self._time, 1e-3)
        self._time, self._used = now, used
        if self._urgent and share > _FLOOD:
            self._ask(0)
            self._urgent = False
        elif not self._urgent and share < _CALM:
            self._urgent = self._ask(_URGENT)

    @staticmethod
    def _ask(niceness: int) -> bool:
        """Whether it was permitted."""
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, 0, niceness)
            return True
        return False


# --------------------------------------------------------------------------------------------------
# What the servers of a run counted, for the run's report.


#: key of a server's report → what people read
_COUNTS = {
    "dropped": "rows dropped because the server was too slow",
    "not_sent": "messages dropped for slow readers",
    "unread": "messages lost in a flood",
    "refused": "messages or connections refused",
    "stale": "commands refused because they had waited",
}


def describe_servers(servers: Sequence[Mapping[str, Any]]) -> list[str]:
    """One line for each server that dropped or refused something; of the others there is nothing to say.

    >>> describe_servers([{"server": "osc", "refused": 3, "dropped": 0}, {"server": "lsl", "dropped": 0}])
    ['osc: 3 messages or connections refused']
    """
    lines = []
    for one in servers:
        counted = [f"{one[key]} {text}" for key, text in _COUNTS.items() if one.get(key)]
        if counted:
            lines.append(f"{one['server']}: {'; '.join(counted)}")
    return lines
