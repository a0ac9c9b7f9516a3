"""Servers of a run (`--serve`): preparation, processes, ports, and the device as a server process sees it."""

from __future__ import annotations

import contextlib
import errno
import json
import math
import os
import socket
import subprocess
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass, field, replace
from importlib import import_module
from pathlib import Path
from time import monotonic, process_time, sleep
from types import TracebackType
from typing import Any, Literal, Protocol, Self, cast, final

from haptorb.arrays import Array, record, whole_number
from haptorb.child_process import pack
from haptorb.devices.base import Device
from haptorb.errors import DriverError, HaptorbError, InputError, UnknownName, quote
from haptorb.files import foreign_text, private_temporary_folder
from haptorb.runtime.config import RunConfig
from haptorb.runtime.linux import end_process, is_parent_gone, require_linux, run_uninterrupted, send_beside
from haptorb.runtime.liveness import HangWatch
from haptorb.runtime.prestart import start_module
from haptorb.runtime.servo import Servo
from haptorb.runtime.shared_memory import BUTTONS, Phase, SharedMemory, TextSlot, Word
from haptorb.runtime.world_output import show
from haptorb.simulation.hand_motion import SampledPath, ScriptedMotion
from haptorb.version import __version__
from haptorb.web.access import LOOPBACK
from haptorb.worlds import Remote
from haptorb.worlds.base import World
from haptorb.worlds.client_force import HOLD_TIME_S
from haptorb.worlds.scene import SceneFile
from haptorb.worlds.user_world import FileWithRemote, WorldFile

__all__ = [
    "CLIENT_TIMEOUT_S",
    "KINDS",
    "MAX_WAIT_S",
    "OTHER_LOOPBACK",
    "KindModule",
    "ProgramHold",
    "ServedDevice",
    "ServerChoice",
    "ServerKind",
    "ServerPreparation",
    "ServerPriority",
    "Serving",
    "add_client_force",
    "check_hand_start",
    "check_port",
    "check_servers",
    "describe_servers",
    "has_other_loopback",
    "hold_tool",
    "is_client_force_alone",
    "load_kind",
    "open_port",
    "port_owner",
]


# --------------------------------------------------------------------------------------------------
# Interface of a server process to the running device: rows, control by one client at a time, and status reports.


CLIENT_TIMEOUT_S = 2.0  #: a client that sends no command for this long loses control of the device [s]
MAX_WAIT_S = 1.0  #: a request that waited unread for longer than this is discarded [s]
_SESSIONS_PER_SERVER = 10_000  #: session numbers reserved for each server
_MAX_HOLDS = 8  #: programs that commanded, listed in the reports of a server: the last ones
_MAX_NAME = 60  #: characters of a program's name there
_MAX_COMMANDED_FORCE_N = 1e6  #: per component [N, N·m]; the limits of the world and the guard are far lower


@dataclass
class ProgramHold:
    """A program's time in command of the device.

    name, session     of the program
    start_s, end_s    on the loop's clock [s]; end_s None: it commands now
    end               "released": it closed the device or switched its forces off; "exited": its process ended or its
                      connection was lost; "silent": it commanded nothing for too long; "": it commands now
    """

    name: str
    session: int
    start_s: float
    end_s: float | None = None
    end: str = ""


@final
class ServedDevice:
    """Device interface of one server process: reads rows, commands a force, reports clients.

    `slot` is the server's number, `shared` the memory of the loop, `parent` the process id of the program that started
    both.

    device   the running device
    facts    of the run: driver, tracker, estimator, model, rate_hz, modes, versions
    dropped  rows lost because this server read too slowly
    busy     commands refused because another client controls the device
    stale    commands refused because they waited too long for this server
    """

    def __init__(self, shared: SharedMemory, slot: int, parent: int, device: Device, facts: Mapping[str, Any]) -> None:
        self.device, self.facts, self.layout = device, dict(facts), shared.layout
        self.dropped = self.busy = self.stale = 0
        self.ending = False  #: set to end this server
        self._shared, self._slot, self._parent = shared, slot, parent
        self._block = shared.force_block(slot)
        self._cursor = shared.ring.count
        self._sessions = _SESSIONS_PER_SERVER * slot
        self._holder, self._held_since = 0, 0.0
        self._holds: list[ProgramHold] = []
        self._names: dict[int, str] = {}
        self._facts: dict[str, Any] = {}  # the last report
        self._world_number, self._renders = -1, False

    @property
    def over(self) -> bool:
        """Whether the server must end: on request, with the servo, or because its parent process is gone."""
        words = self._shared.words
        return bool(self.ending or words[Word.QUIT] or words[Word.PHASE] >= Phase.ENDED or is_parent_gone(self._parent))

    @property
    def origin(self) -> float:
        """Monotonic time at which the loop's clock, `t` of the rows, was zero [s]."""
        return float(self._shared.words[Word.ORIGIN]) * 1e-9

    def latest(self) -> Array | None:
        """The newest row (width,), in the units of `layout`; None before the first."""
        return self._shared.ring.latest()

    def read_rows(self) -> Array:
        """Rows (n, width) published since the last call, oldest first, in the units [..] of `layout`.

        Does not block; rows that were overwritten before they were read are counted in `dropped`."""
        before = self._cursor
        self._cursor, rows = self._shared.ring.read_since(before)
        self.dropped += self._cursor - before - len(rows)
        return rows

    @property
    def tick_count(self) -> int:
        """Number of rows published so far; it changes with every new row."""
        return int(self._shared.ring.count)

    @property
    def world(self) -> dict[str, Any]:
        """The rendered world: `name`, `values` and the `memory` fields of its rows; empty before the first."""
        changes = self._shared.worlds_since(self._shared.words[Word.WORLD] - 1)
        return dict(json.loads(changes[-1][1])) if changes else {}

    @property
    def renders_force(self) -> bool:
        """Whether the current world includes the clients' force; the user may have selected one that does not."""
        number = int(self._shared.words[Word.WORLD])
        if number != self._world_number:
            names = [field["name"].rpartition("_")[2] for field in self.world.get("memory", [])]
            self._world_number, self._renders = number, {"force", "session", "fade"} <= set(names)
        return self._renders

    @property
    def buttons(self) -> dict[str, bool]:
        """Pressed state of the buttons a, b, c, from the user or a scripted hand."""
        bits = self.button_bits
        return {name: bool(bits >> i & 1) for i, name in enumerate(BUTTONS)}

    @property
    def button_bits(self) -> int:
        """Pressed buttons as a bit mask; bit 0 is a."""
        return int(self._shared.words[Word.BUTTONS]) | self._shared.hand.buttons

    @property
    def grip(self) -> float:
        """Opening to which thumb and finger of a scripted hand move [m]; NaN without one."""
        return self._shared.hand.grip

    def begin_hand(self) -> None:
        """Let a scripted hand begin that waits for a program; again it has no effect."""
        self._shared.hand.begin()

    def open_session(self) -> int:
        """Return a session number for a new client, unique within the run."""
        self._sessions += 1
        return self._sessions

    def _begin_hold(self, session: int) -> None:
        self._names = {session: self._names.get(session, "")}
        if self._holds and self._holds[-1].session == session:  # after a pause
            self._holds[-1].end_s, self._holds[-1].end = None, ""
            return
        hold = ProgramHold(self._names[session], session, round(monotonic() - self.origin, 4))
        self._holds = [*self._holds, hold][-_MAX_HOLDS:]

    def _end_hold(self, when: float, end: str) -> None:
        self._holder = 0
        if self._holds and self._holds[-1].end_s is None:
            self._holds[-1].end_s, self._holds[-1].end = round(when - self.origin, 4), end

    @property
    def holder(self) -> int:
        """Session of the client that controls the device; 0: none."""
        if self._holder and monotonic() - self._held_since > CLIENT_TIMEOUT_S:
            self._end_hold(self._held_since, "silent")
        return self._holder

    def command(
        self, session: int, force: Sequence[float], *, arrival: float | None = None, mapping: int = 0,
        torque: Sequence[float] = (0.0, 0.0, 0.0), gripper: float = 0.0,
    ) -> bool:  # fmt: skip
        """Command `force` (3,) [N] and `torque` (3,) [N·m], stator frame, and the force of the `gripper` [N], positive
        to open, for the client `session`; returns whether it was accepted.

        `arrival` is the arrival time of the message on the monotonic clock [s]; None: now. The command is refused if
        another client controls the device, if the numbers are not finite, or if the message waited for longer than a
        command lasts.

        A zero force does not acquire control: many programs that only observe send zeros to get the state in reply.
        """
        numbers = (*force, *torque, gripper)
        if self.holder != session and not any(numbers):
            return True
        if self.holder not in (0, session):  # safety: watcher-commands-nothing
            self.busy += 1
            return False
        if not all(
            -_MAX_COMMANDED_FORCE_N <= number <= _MAX_COMMANDED_FORCE_N for number in numbers
        ):  # safety: served-force-finite
            return False
        now = monotonic()
        since = now if arrival is None else min(arrival, now)
        if now - since > HOLD_TIME_S:  # safety: waited-is-stale
            self.stale += 1
            return False
        if self._holder != session:
            self._begin_hold(session)
        self._holder, self._held_since = session, since
        self._block.command(force, session, since, mapping, torque, gripper)
        return True

    def lose(self, session: int, end: str = "exited") -> None:
        """End the force of a client `session` whose connection was lost, and release the device if it had control.

        `end` is how, see `ProgramHold`."""
        if self._holder == session:
            self._block.lose(monotonic())  # safety: lost-client-told
            self._end_hold(monotonic(), end)

    def request_world(self, name: str, values: Mapping[str, Any]) -> None:
        """Request the world `name` with `values` from the program that runs the servo.

        A newer request replaces one that was not read yet."""
        self._shared.server_requests[self._slot].write(json.dumps({"name": name, "values": dict(values)}, default=list))

    def report(self, server: str, address: str, clients: Sequence[Mapping[str, Any]], **more: Any) -> None:
        """Publish the connected clients for the user: each of `clients` has `name`, `session`, `rate_hz` and `holds`.

        Call it at most four times a second. Above 50 clients, the others are only counted. The report has the programs
        that commanded, too: the last 8."""
        self._names |= {int(one["session"]): foreign_text(one["name"], _MAX_NAME) for one in clients if one["holds"]}
        for hold in self._holds:
            hold.name = hold.name or self._names.get(hold.session, "")
        facts = {
            "server": server, "address": address, "count": len(clients), "clients": list(clients[:50]),
            "dropped": self.dropped, "stale": self.stale, "programs": [asdict(one) for one in self._holds], **more,
        }  # fmt: skip
        self._facts = facts
        self._shared.server_facts[self._slot].write(json.dumps(facts))

    def conclude(self) -> None:
        """Publish the final report of this server: no clients; its counts stay for the report of the run."""
        if self._facts:
            programs = [asdict(one) for one in self._holds]
            self._facts |= {"count": 0, "clients": [], "dropped": self.dropped, "programs": programs}
            self._shared.server_facts[self._slot].write(json.dumps(self._facts))


# --------------------------------------------------------------------------------------------------
# Preparation of a server before the servo starts: settings and open ports.


def _describe_nothing(device: Device) -> tuple[str, ...]:
    """No lines on what programs will see of `device`."""
    return ()


@dataclass
class ServerPreparation:
    """Settings and open sockets of a server that is ready to start.

    spec         settings of the server process, plain JSON types
    descriptors  open sockets that it inherits, in order; closed here once it has them
    address      address of the server, as shown to the user
    remarks      further information for the user, such as a token
    describe     what programs will see of a device, for the user
    """

    spec: dict[str, Any]
    address: str
    descriptors: list[int] = field(default_factory=list)
    remarks: tuple[str, ...] = ()
    describe: Callable[[Device], tuple[str, ...]] = _describe_nothing

    def close(self) -> None:
        """Close this process's copies of the sockets. May be called twice."""
        while self.descriptors:
            os.close(self.descriptors.pop())


# --------------------------------------------------------------------------------------------------
# Registry of the server kinds of `--serve`; to add one, write a module and add an entry here.


@record
class ServerKind:
    """Registry entry of a server kind, available before its module is loaded.

    form     syntax of the argument of --serve
    module   module with its `prepare` and `serve`, see `KindModule`
    package  package that must be installed for it; empty: none
    world    effect on the world: "alone": without --world, only the clients' force is rendered; "added": the clients'
             force is added to the current world; "unchanged": its clients command no force
    """

    form: str
    module: str
    package: str
    world: Literal["alone", "added", "unchanged"]


class KindModule(Protocol):
    """Interface of a server kind's module."""

    def prepare(self, where: str) -> ServerPreparation:
        """Parse `where`, the text after the colon of --serve, and open the ports; runs in the program that starts the
        servo. Raises InputError with the expected syntax."""

    def serve(self, spec: dict[str, Any], descriptors: list[int], served: ServedDevice) -> None:
        """Serve until `served.over`, with the `spec` and the open `descriptors` of the preparation; runs in the server
        process."""


#: name before the colon of --serve → registry entry
KINDS: dict[str, ServerKind] = {
    "haply": ServerKind("haply[:HOST][:PORT[:EVENTS]]", "haptorb.serve.haply", "", "alone"),
    "osc": ServerKind("osc[:[HOST:]PORT]", "haptorb.serve.osc", "pythonosc", "added"),
    "lsl": ServerKind("lsl", "haptorb.serve.lsl", "pylsl", "unchanged"),
    "foxglove": ServerKind("foxglove[:PORT]", "haptorb.serve.foxglove", "foxglove", "unchanged"),
    "native": ServerKind("native[:SCALE]", "haptorb.serve.native", "", "alone"),
}


def load_kind(name: str) -> KindModule:
    """Import the module of the kind `name`. Raises DriverError if a package that it needs is not installed."""
    kind = KINDS[name]
    try:
        if kind.package:
            import_module(kind.package)
    except (ImportError, OSError, RuntimeError) as cause:  # pylsl raises RuntimeError if liblsl is missing
        raise DriverError(
            f"--serve {name} needs a package that is not installed ({cause}): pip install 'haptorb[serve]'"
        ) from cause
    return cast("KindModule", import_module(kind.module))


# --------------------------------------------------------------------------------------------------
# Parsing of `--serve KIND[:...]`, the world that the clients' force needs, and the server processes.


@record
class ServerChoice:
    """One option `--serve`: the `kind`, and the text `where` after its colon."""

    kind: str
    where: str


def check_servers(texts: Sequence[str]) -> tuple[ServerChoice, ...]:
    """Parse the arguments `texts` of --serve; opens nothing.

    Raises UnknownName for an unknown kind, InputError for two of one kind.

    >>> check_servers(["haply:10001:10020"])
    (ServerChoice(kind='haply', where='10001:10020'),)
    """
    if texts:
        require_linux("`--serve`")  # only its kernel tells the account behind a connection
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
    """Whether, without --world, only the clients' force is rendered."""
    return any(KINDS[choice.kind].world == "alone" for choice in choices)


def check_hand_start(start: str, hand: object, choices: Sequence[ServerChoice]) -> str:
    """`start` of the motion `hand`, None without one. Raises InputError for a wait that would not end."""
    if start == "program" and (hand is None or all(choice.kind != "native" for choice in choices)):
        raise InputError(
            "--hand-start program waits for a program that opens the device: it needs --hand FILE and --serve native"
        )
    return start


_HOLD_HEIGHT_M = 0.002  #: height above the dome at which a simulated tool without a user is held [m]


def hold_tool(config: RunConfig, choices: Sequence[ServerChoice]) -> RunConfig:
    """`config` with a simulated tool at rest from the first tick, for a run that serves programs without a console.

    Programs need a cursor that does not move by itself. Nothing changes where no program is served, and where a script
    or a tracker moves the tool. A tool over a dome is held 2 mm above it.
    """
    if not choices or config.is_real or config.hand is not None or config.tracker not in ("pointer", "hall"):
        return config
    shell, rest = config.device.shell, config.device.rest_position
    p = rest if shell is None else (0.0, 0.0, shell.contact_distance + _HOLD_HEIGHT_M)
    return replace(config, hand=ScriptedMotion(SampledPath([[*p, 0.0, 0.0, 0.0, 1.0]], [0.0], math.inf)))


def add_client_force(
    world: World | WorldFile | SceneFile, choices: Sequence[ServerChoice]
) -> World | FileWithRemote | WorldFile | SceneFile:
    """Add the clients' force to `world` if one of these servers has clients that command forces.

    A world from a file has the force again after each reload."""
    if isinstance(world, Remote) or all(KINDS[choice.kind].world == "unchanged" for choice in choices):
        return world
    return FileWithRemote(world) if isinstance(world, WorldFile | SceneFile) else world + Remote()


_START_TIMEOUT_S = 30.0  #: for a server process to serve [s]
_HANG_TIMEOUT_S = 4.0  #: a starting server without progress for this long hangs [s]
_END_TIMEOUT_S = 1.5  #: for all servers to end on request before they are killed [s]
_REQUEST_POLL_INTERVAL_S = 0.02  #: polling interval of the servers' requests [s]


@final
class _Server:
    def __init__(self, choice: ServerChoice, number: int) -> None:
        self.choice, self.number = choice, number
        self.preparation: ServerPreparation = load_kind(choice.kind).prepare(choice.where)
        self.process: subprocess.Popen[bytes] | None = None
        self.request_version = 0  # of the last request that was read
        self.reported_end = False  # whether the user was informed that its process ended


@final
class Serving:
    """Server processes `choices` of `servo`: opens the ports at once; call `start` when the servo runs.

    Raises InputError for an address that is not available, DriverError for a package that is not installed.
    """

    def __init__(self, choices: Sequence[ServerChoice], servo: Servo) -> None:
        self._servo, self._servers = servo, list[_Server]()
        self._ending = threading.Event()
        self._watcher: threading.Thread | None = None
        self._folder: Path | None = None
        self._folders = ExitStack()  #: removes it
        try:
            for number, choice in enumerate(choices):
                self._servers.append(_Server(choice, number))
        except BaseException:
            self.end()
            raise

    @property
    def lines(self) -> list[str]:
        """Address of each server and its remarks, one line each, for the user."""
        return [
            line
            for one in self._servers
            for line in (
                f"{one.choice.kind}: {one.preparation.address}",
                *one.preparation.remarks,
                *one.preparation.describe(self._servo.device),
            )
        ]

    def start(self) -> None:
        """Start the server processes and block until all of them serve.

        Raises DriverError with the reason if one fails."""
        if not self._servers:
            return
        self._folder = self._folders.enter_context(private_temporary_folder("serve"))
        shared = SharedMemory(self._servo.memory_path)
        for one in self._servers:
            self._start_process(one)
        deadline = monotonic() + _START_TIMEOUT_S
        for one in self._servers:
            assert one.process is not None
            watch, hung = HangWatch(one.process.pid), 0.0
            while shared.words[Word.SERVERS + one.number] == Phase.STARTING:
                hung = watch.update()
                if one.process.poll() is not None or monotonic() > deadline or hung > _HANG_TIMEOUT_S:
                    break
                sleep(0.002)
            if shared.words[Word.SERVERS + one.number] != Phase.RUNNING:
                why = f"its process did nothing for {hung:.0f} s and was ended" if hung > _HANG_TIMEOUT_S else ""
                raise DriverError(f"--serve {one.choice.kind} did not start: {why or self._explain_end(one)}")
            one.preparation.close()
        self._watcher = threading.Thread(target=self._poll_servers, args=(shared,), name="haptorb-servers", daemon=True)
        self._watcher.start()

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
            errors=self._error_file(one), stdin=subprocess.PIPE, descriptors=tuple(prepared.descriptors),
        )  # fmt: skip
        # A device with its tables is larger than a pipe; what a process does that hangs is watched by `start`.
        send_beside(one.process, pack(spec))  # safety: start-sends-beside

    def _error_file(self, one: _Server) -> Path:
        assert self._folder is not None
        return self._folder / f"{one.choice.kind}.txt"

    def _explain_end(self, one: _Server) -> str:
        text = ""
        with contextlib.suppress(OSError):
            text = self._error_file(one).read_text(encoding="utf-8", errors="replace")[-2000:].strip()
        code = None if one.process is None else one.process.poll()
        return text or ("no answer" if code is None else f"its process ended with code {code}")

    def _poll_servers(self, shared: SharedMemory) -> None:
        """Apply requests of the servers and report a server that ended, until `end`."""
        while not self._ending.wait(_REQUEST_POLL_INTERVAL_S):
            for one in self._servers:
                self._apply_request(one, shared.server_requests[one.number])
                over = one.process is not None and one.process.poll() is not None
                ends = shared.words[Word.QUIT] or shared.words[Word.PHASE] >= Phase.ENDED  # then they end by themselves
                if over and not ends and self._servo.alive and not one.reported_end:
                    one.reported_end = True
                    show(f"--serve {one.choice.kind} ended, the servo continues: {self._explain_end(one)}\n")

    def _apply_request(self, one: _Server, requests: TextSlot) -> None:
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
        """End all servers; kill those that do not end on request. May be called twice."""
        self._ending.set()
        run_uninterrupted(self._end_all)

    def _end_all(self, _: threading.Event) -> None:
        if self._watcher is not None:
            self._watcher.join(_END_TIMEOUT_S)
            self._watcher = None
        running = [one for one in self._servers if one.process is not None and one.process.poll() is None]
        for one in running:
            one.process.terminate()  # type: ignore[union-attr]
        deadline = monotonic() + _END_TIMEOUT_S
        for one in running:
            if not end_process(one.process, max(deadline - monotonic(), 0.0)):
                kind, number = one.choice.kind, one.process.pid  # type: ignore[union-attr]
                show(f"--serve {kind} cannot be ended: the kernel holds its process {number}\n")
        for one in self._servers:
            one.preparation.close()
        self._folders.close()
        self._folder = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.end()


def describe_run(servo: Servo) -> dict[str, Any]:
    """Facts of the run for a server process, plain JSON types."""
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
# Ports of servers, with errors that name the program that uses a port.


OTHER_LOOPBACK = "::1"
_MAX_PENDING_CONNECTIONS = 128  #: backlog of connections that are not accepted yet
_SEND_BUFFER_BYTES = 262144  #: the kernel's buffer for a slow client [bytes]


def check_port(text: str, form: str) -> int:
    """Parse a port, 0 to 65535 (0: any free one). Raises InputError with the `form` of the option.

    >>> check_port("10001", "foxglove[:PORT]")
    10001
    """
    port = whole_number(text)
    if port is None or port > 65535:
        raise InputError(f"--serve {form}: a port is a whole number from 0 to 65535; got {quote(text)}")
    return port


def has_other_loopback() -> bool:
    """Whether this computer has the IPv6 loopback address ::1."""
    with suppress(OSError), socket.socket(socket.AF_INET6, socket.SOCK_STREAM) as probe:
        probe.bind((OTHER_LOOPBACK, 0))
        return True
    return False


def open_port(port: int, option: str, *, host: str = LOOPBACK, datagrams: bool = False) -> socket.socket:
    """Open a socket on `port` of `host`: UDP for `datagrams`, else TCP and listening.

    Raises InputError with the program that uses the port and the `option` that selects another.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    found = socket.socket(family, socket.SOCK_DGRAM if datagrams else socket.SOCK_STREAM)
    try:
        if not datagrams:
            found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            found.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)
        found.bind((host, port))
        if not datagrams:
            found.listen(_MAX_PENDING_CONNECTIONS)
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
    """Program that uses `port`, as "NAME (process ID)"; empty if it runs under another account."""
    kind = "udp" if datagrams else "tcp"
    nodes = _port_nodes(port, kind) | _port_nodes(port, f"{kind}6")
    links = {f"socket:[{node}]" for node in nodes}
    for process in Path("/proc").glob("[0-9]*") if links else ():
        with suppress(OSError):
            for descriptor in (process / "fd").iterdir():
                with suppress(OSError):
                    if str(descriptor.readlink()) in links:
                        return f"{(process / 'comm').read_text(encoding='utf-8').strip()} (process {process.name})"
    return ""


def _port_nodes(port: int, table: str) -> set[str]:
    """Inodes of the sockets bound to `port` in one of the kernel's tables."""
    found = set()
    with suppress(OSError):
        for line in Path(f"/proc/net/{table}").read_text(encoding="utf-8").splitlines()[1:]:
            words = line.split()
            bound = int(words[1].rpartition(":")[2], 16) == port
            if bound and (table.startswith("udp") or words[3] == "0A"):  # 0A: listening
                found.add(words[9])
    return found


# --------------------------------------------------------------------------------------------------
# Scheduling priority: above ordinary programs while the server is mostly idle, so that a reply does not wait for a
# processor.


_HIGH_PRIORITY_NICENESS = -10  #: below the priority of each loop and of the console's server
_MAX_PROCESSOR_SHARE = 0.6  #: a server that uses more of one processor is flooded: normal priority
_RESUME_PROCESSOR_SHARE = 0.4  #: below it, the priority is raised again


@final
class ServerPriority:
    """Scheduling priority of this process; call `update` periodically."""

    def __init__(self) -> None:
        self._time, self._used = monotonic(), process_time()
        self._urgent = self._set_niceness(_HIGH_PRIORITY_NICENESS)

    def update(self) -> None:
        """Use normal priority while clients keep the processor busy, high priority otherwise."""
        now, used = monotonic(), process_time()
        share = (used - self._used) / max(now - self._time, 1e-3)
        self._time, self._used = now, used
        if self._urgent and share > _MAX_PROCESSOR_SHARE:
            self._set_niceness(0)
            self._urgent = False
        elif not self._urgent and share < _RESUME_PROCESSOR_SHARE:
            self._urgent = self._set_niceness(_HIGH_PRIORITY_NICENESS)

    @staticmethod
    def _set_niceness(niceness: int) -> bool:
        """Set the niceness of this process; returns whether it was permitted."""
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, 0, niceness)
            return True
        return False


# --------------------------------------------------------------------------------------------------
# Error counts of the servers, for the report of the run.


#: key of a server's report → text for the user
_COUNT_TEXTS = {
    "dropped": "rows dropped because the server was too slow",
    "not_sent": "messages dropped for slow readers",
    "unread": "messages lost in a flood",
    "refused": "messages or connections refused",
    "stale": "commands refused because they had waited",
}


_END_TEXTS = {
    "released": "when it gave the device back",
    "exited": "when it ended or its connection was lost",
    "silent": "when it sent no more commands",
}


def _describe_hold(hold: Mapping[str, Any]) -> str:
    since = f"{hold['name'] or 'a program'} commanded from {hold['start_s']:.2f} s"
    if hold["end_s"] is None:
        return f"{since} on"
    return f"{since} to {hold['end_s']:.2f} s, {_END_TEXTS.get(hold['end'], 'when it ended')}"


def describe_servers(servers: Sequence[Mapping[str, Any]]) -> list[str]:
    """Format one line for each program that commanded, and for each server that dropped or refused something.

    >>> hold = {"name": "demo", "session": 1, "start_s": 0.5, "end_s": 2.0, "end": "exited"}
    >>> describe_servers([{"server": "native", "programs": [hold]}])
    ['native: demo commanded from 0.50 s to 2.00 s, when it ended or its connection was lost']
    >>> describe_servers([{"server": "osc", "refused": 3, "dropped": 0}, {"server": "lsl", "dropped": 0}])
    ['osc: 3 messages or connections refused']
    """
    lines = []
    for one in servers:
        lines += [f"{one['server']}: {_describe_hold(hold)}" for hold in one.get("programs", ())]
        counted = [f"{one[key]} {text}" for key, text in _COUNT_TEXTS.items() if one.get(key)]
        if counted:
            lines.append(f"{one['server']}: {'; '.join(counted)}")
    return lines
