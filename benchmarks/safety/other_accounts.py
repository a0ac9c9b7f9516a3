"""Attacks of another account of this computer on a run: coils, poses, tokens, and the tracker's pose.

    python benchmarks/safety/other_accounts.py [--attempts N]        (as root: it starts a process of the account 65534)

`haptorb run` renders clients' forces with console, the servers `haply`, `osc`, `foxglove` and `native`, and a tracker
`osc`: with everything on loopback, without any token and with one, and with tracker and OSC server open to the network.
A program of this account watches through `haply` and sends poses, in some of the runs only until the attack begins; 200
programs a second of this account come to the OSC server, with the token where there is one. A process that has given
up this account for good tries in turn: to bind each port, while these programs come; WebSockets of `haply`, `foxglove`
and console; requests of `haply` over HTTP; forces, subscriptions, parameters and worlds by OSC; poses and losses for
the tracker; the arguments, environments and files of all processes, shared memory and temporary files, where it looks
for the tokens, given and generated. Every attempt that is answered with more than a refusal counts, and so does a
session that holds the device, a force, or a pose that is not the sender's. Then the pages of `haptorb study run`, whose
participant's page is open: every event that one without the token is told counts. Last the pages of a recording, of a
study's report and of found designs.
"""

from __future__ import annotations

import argparse
import encodings.idna  # noqa: F401  # another account may not be able to read Python's own files any more
import json
import os
import re
import secrets
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path
from typing import Any

from websockets.exceptions import WebSocketException
from websockets.sync.client import connect

NOBODY = 65534
COMMAND = "from haptorb.cli import main; raise SystemExit(main())"
PLACE = (0.001, 0.002, 0.055)
ELSEWHERE = (0.02, 0.0, 0.06)
MOVED = 2e-3  #: of the pose, that no noise makes [m]
#: where tracker and OSC server listen, whether there are tokens, whether this account goes on sending poses
RUNS = (
    ("127.0.0.1", False, True), ("127.0.0.1", False, False), ("127.0.0.1", True, True), ("0.0.0.0", True, True),
    ("0.0.0.0", False, False),
)  # fmt: skip
START = 240.0  #: for a run whose code must be compiled first [s]
UPGRADE = (
    "GET {path} HTTP/1.1\r\nHost: localhost:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n{more}\r\n"
)
STUDY = (
    'name = "watched"\n[set_points]\npoints = [{ number = 1, theta_deg = 0 }, { number = 2, theta_deg = 36 }]\n'
    "[trials]\nrepetitions = 1\n"
)
PAGES = """
import os, sys, threading
from types import SimpleNamespace
from haptorb.web.view import Viewer
from haptorb_design.chooser import Chooser
from haptorb_study.pages.report_server import ReportServer
pages = {
    "view": Viewer([sys.argv[1]], 0), "report": ReportServer("<p>a report</p>", [], 0),
    "chooser": Chooser(SimpleNamespace(describe=lambda: {"designs": []}, found=[]), 0),
}
for name, page in pages.items():
    threading.Thread(target=page.serve, daemon=True).start()
    print(name, page.url, flush=True)
sys.stdin.read()
os._exit(0)
"""
TAKING = 0.5  #: one attempt to bind the ports [s]
#: a token in what a run prints
TOKEN = re.compile(r"(?:token[^:\n]*: |token=|#)([A-Za-z0-9_-]{16,})")
PUSH = {"inverse3": [{"commands": {"set_cursor_force": {"vector": {"x": 0.5, "y": 0.0, "z": 0.0}}}}]}


def osc(address: str, *values: Any) -> bytes:
    """An OSC message of texts and floats."""

    def pad(text: str) -> bytes:
        return text.encode() + b"\0" * (4 - len(text) % 4)

    kinds = "," + "".join("s" if isinstance(value, str) else "f" for value in values)
    data = b"".join(pad(value) if isinstance(value, str) else struct.pack(">f", value) for value in values)
    return pad(address) + pad(kinds) + data


class Stranger:
    """What another account tries; each attempt returns what it got, empty for nothing."""

    def __init__(self, ports: dict[str, int], tokens: list[str]) -> None:
        self.ports, self.tokens = ports, [one.encode() for one in tokens]
        self.attempts: list[Callable[[], str]] = [
            self.take_ports,
            lambda: self.upgrade("haply"), lambda: self.upgrade("events"), lambda: self.upgrade("foxglove"),
            lambda: self.upgrade("console", "/ws"), lambda: self.request("GET", "/devices"),
            lambda: self.request("POST", "/inverse3/0/config/workspace", '{"scale": -1}'),
            lambda: self.datagrams("osc", osc("/haptorb/force", 0.5, 0.0, 0.0)),
            lambda: self.datagrams("osc", osc("/haptorb/subscribe")),
            lambda: self.datagrams("osc", osc("/haptorb/world", "magnet")),
            lambda: self.datagrams("osc", osc("/haptorb/force", secrets.token_urlsafe(16), 0.5, 0.0, 0.0)),
            lambda: self.datagrams("tracker", osc("/haptorb/pose", *ELSEWHERE, 0.0, 0.0, 0.0, 1.0)),
            lambda: self.datagrams("tracker", osc("/haptorb/lost")),
            lambda: self.datagrams("tracker", osc("/haptorb/pose", "token", *ELSEWHERE, 0.0, 0.0, 0.0, 1.0)),
            self.send_poses, self.read_processes, self.read_files,
        ]  # fmt: skip
        if "study" in ports:
            words = ("", "none", secrets.token_urlsafe(16), '{"do": "agree", "agreed": true}', '{"do": "stop"}')
            self.attempts = [
                partial(self.open_page, page, word) for word in words for page in ("participant", "experimenter")
            ]
            self.attempts.append(self.read_processes)
        if "view" in ports:
            word = secrets.token_urlsafe(16)
            self.attempts = [
                partial(self.request, "GET", "/api/view", port="view"),
                partial(self.request, "GET", "/api/session?recording=0", port="view"),
                partial(self.request, "GET", "/api/overview?recording=0", port="view"),
                partial(self.upgrade, "view", "/ws?recording=0"),
                partial(self.request, "GET", f"/{word}/", port="report"),
                partial(self.request, "GET", f"/{word}/play/0", port="report"),
                *(partial(self.request, "GET", path, port="chooser") for path in ("/api/designs", "/api/now")),
                partial(self.request, "POST", "/api/choose", '{"row": -1}', port="chooser"),
                partial(self.request, "POST", "/api/stop", port="chooser"), self.read_processes,
            ]  # fmt: skip

    def take_ports(self) -> str:
        """Bind each port, again and again: a server lets in another socket for a moment, if it does."""
        end, n = time.monotonic() + TAKING, 0
        ways = [(socket.SO_REUSEADDR,), (socket.SO_REUSEPORT,), (socket.SO_REUSEADDR, socket.SO_REUSEPORT)]
        while time.monotonic() < end:
            n += 1
            for name, port in self.ports.items():
                kind = socket.SOCK_DGRAM if name in ("osc", "tracker") else socket.SOCK_STREAM
                if kind == socket.SOCK_STREAM and n > 6:
                    continue
                with socket.socket(socket.AF_INET, kind) as taken, suppress(OSError):
                    for option in ways[n % 3]:
                        taken.setsockopt(socket.SOL_SOCKET, option, 1)
                    taken.bind((("127.0.0.1", "0.0.0.0")[n % 2], port))
                    if kind == socket.SOCK_STREAM:
                        taken.listen()
                        return f"the port of {name}"
                    taken.settimeout(1.0)
                    with suppress(TimeoutError):
                        if any(token in taken.recv(4096) for token in self.tokens):
                            return f"the port of {name}, and a token"
                    return f"the port of {name}"
        return ""

    def _exchange(self, port: int, data: str) -> bytes:
        with socket.create_connection(("127.0.0.1", port), timeout=1.0) as client:
            client.sendall(data.encode())
            return client.recv(4096)

    def upgrade(self, name: str, path: str = "/") -> str:
        port = self.ports[name]
        answer = self._exchange(port, UPGRADE.format(path=path, port=port, more="Sec-WebSocket-Protocol: haptorb\r\n"))
        return "" if b" 101 " not in answer.splitlines()[0] + b" " else f"a WebSocket of {name}"

    def open_page(self, page: str, word: str) -> str:
        """A page of a study that says `word` first, and one that is there while nobody says anything."""
        port = self.ports["study"]
        ask = UPGRADE.format(path=f"/ws/{page}", port=port, more="").encode()
        with socket.create_connection(("127.0.0.1", port), timeout=1.0) as client:
            client.sendall(ask + bytes((0x81, 0x80 | len(word), 0, 0, 0, 0)) + word.encode())
            answer = b""
            with suppress(OSError):  # a page that is served stays open
                while part := client.recv(4096):
                    answer += part
        return f"an event of the {page}'s page of a study" if b'"event"' in answer else ""

    def request(self, method: str, path: str, body: str = "", port: str = "haply") -> str:
        head = f"{method} {path} HTTP/1.1\r\nHost: localhost\r\nContent-Length: {len(body)}\r\n\r\n{body}"
        answer = self._exchange(self.ports[port], head)
        return "" if b" 200 " not in answer.splitlines()[0] else f"an answer of {port} to {method} {path}"

    def datagrams(self, name: str, data: bytes) -> str:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            sender.settimeout(0.1)
            for _ in range(3):
                sender.sendto(data, ("127.0.0.1", self.ports[name]))
            with suppress(OSError):
                if not sender.recv(4096).startswith(b"/haptorb/error"):
                    return f"an answer of {name}"
        return ""

    def send_poses(self) -> str:
        """Poses from one port for 2.5 s: whoever replaces a sender is believed after a moment."""
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            for _ in range(250):
                sender.sendto(
                    osc("/haptorb/pose", *ELSEWHERE, 0.0, 0.0, 0.0, 1.0), ("127.0.0.1", self.ports["tracker"])
                )
                time.sleep(0.01)
        return ""

    def read_processes(self) -> str:
        for process in Path("/proc").glob("[0-9]*"):
            for name in ("cmdline", "environ"):
                with suppress(OSError):
                    if any(token in (process / name).read_bytes() for token in self.tokens):
                        return f"a token in {name} of a process"
            with suppress(OSError):
                if process.stat().st_uid != NOBODY and [*(process / "fd").iterdir()]:
                    return "the open files of a process"
        return ""

    def read_files(self) -> str:
        folders = [Path("/dev/shm"), Path("/tmp")]
        folders += [one for folder in folders for one in folder.glob("haptorb*") if one.is_dir()]
        for path in [path for one in folders for path in one.glob("haptorb*" if one in folders[:2] else "*")]:
            with suppress(OSError), path.open("rb") as file:
                file.read(1)
                if path.suffix not in (".lock",):
                    return f"a file of the run: {path}"
        return ""


def attack(count: int, ports: dict[str, int], tokens: list[str], write: int) -> None:
    """In the process of the other account: `count` attempts; what they got goes to `write` as JSON."""
    os.setgroups([])
    os.setresgid(NOBODY, NOBODY, NOBODY)
    os.setresuid(NOBODY, NOBODY, NOBODY)
    stranger, got, tried = Stranger(ports, tokens), Counter[str](), 0
    for n in range(count):
        try:
            if found := stranger.attempts[n % len(stranger.attempts)]():
                got[found] += 1
            tried += 1
        except (OSError, IndexError):  # closed without an answer
            tried += 1
    os.write(write, json.dumps({"tried": tried, "got": got}).encode())


def attack_as_another(count: int, ports: dict[str, int], tokens: list[str]) -> dict[str, Any]:
    """`attack` in a process of the other account: how many were `tried`, and what they `got`."""
    read, write = os.pipe()
    number = os.fork()
    if number == 0:
        try:
            attack(count, ports, tokens, write)
        finally:
            os._exit(0)
    os.close(write)
    with os.fdopen(read) as file:
        found: dict[str, Any] = json.loads(file.read() or '{"tried": 0, "got": {}}')
    os.waitpid(number, 0)
    return found


class Run:
    """A run of haptorb, a program of this account that sends poses, and one that watches."""

    def __init__(self, host: str, tokens: bool, recording: Path | None = None) -> None:
        names = ("console", "haply", "events", "osc", "foxglove", "tracker")
        self.ports = {name: free_port() for name in names}
        names = ("HAPTORB_TOKEN", "HAPTORB_TRACKER_TOKEN", "HAPTORB_SERVE_TOKEN") if tokens else ()
        self.given = {name: secrets.token_urlsafe(16) for name in names}
        self.tokens = list[str]()  #: given and generated
        self.tracker_token = self.serve_token = ""
        self.silent = False  #: nobody else says where the tool is
        self.beyond = host != "127.0.0.1"
        ports = self.ports
        command = [
            sys.executable, "-c", COMMAND, "run", "omni", "--world", "remote", "--port", str(ports["console"]),
            "--serve", f"haply:{ports['haply']}:{ports['events']}", "--serve", f"osc:{host}:{ports['osc']}",
            "--serve", f"foxglove:{ports['foxglove']}", "--serve", "native",
            "--tracker", f"osc:{host}:{ports['tracker']}",
        ]  # fmt: skip
        if recording is not None:
            command += ["--record", str(recording)]
        self.process = subprocess.Popen(
            command, env={**os.environ, **self.given}, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
        )
        self.said = ""
        self.over, self.faults, self.looks, self.answers = threading.Event(), Counter[str](), 0, 0
        self.threads = [threading.Thread(target=one) for one in (self.send, self.watch, self.talk)]
        self.reader = threading.Thread(target=self.read, daemon=True)
        self.reader.start()

    def __enter__(self) -> Run:
        end = time.monotonic() + START
        while True:
            with suppress(OSError, WebSocketException), connect(f"ws://127.0.0.1:{self.ports['haply']}"):
                if "Open http" in self.said:
                    break
            if time.monotonic() > end or self.process.poll() is not None:
                self.process.kill()
                raise SystemExit(f"the run did not start: {self.said[-2000:]}")
            time.sleep(0.2)
        self.tokens = [*{*self.given.values(), *TOKEN.findall(self.said)}]
        lines = {"poses": "", "OSC messages": ""}
        for line in self.said.splitlines():
            lines.update({mark: TOKEN.findall(line)[0] for mark in lines if mark in line and TOKEN.search(line)})
        self.tracker_token = lines["poses"] or self.given.get("HAPTORB_TRACKER_TOKEN", "")
        self.serve_token = lines["OSC messages"] or self.given.get("HAPTORB_SERVE_TOKEN", "")
        if self.beyond and not (self.tracker_token and self.serve_token):
            raise SystemExit(f"the run has printed no token: {self.said[-2000:]}")
        for thread in self.threads:
            thread.start()
        time.sleep(2.0)
        return self

    def read(self) -> None:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self.said += line

    def talk(self) -> None:
        """Programs of this account come to the OSC server, one after another."""
        data = osc("/haptorb/parameters", *([self.serve_token] if self.serve_token else []))
        while not self.over.wait(0.005):
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as program:
                program.settimeout(0.2)
                program.sendto(data, ("127.0.0.1", self.ports["osc"]))
                with suppress(OSError):
                    self.answers += program.recv(4096).startswith(b"/haptorb/world")

    def send(self) -> None:
        token = [self.tracker_token] if self.beyond else []
        data = osc("/haptorb/pose", *token, *PLACE, 0.0, 0.0, 0.0, 1.0)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            while not self.over.wait(0.005):
                if not self.silent:
                    sender.sendto(data, ("127.0.0.1", self.ports["tracker"]))

    def watch(self) -> None:
        first: list[float] | None = None
        with connect(f"ws://127.0.0.1:{self.ports['haply']}") as client:
            client.recv()
            begin = time.monotonic()
            while not self.over.wait(0.005):
                client.send("{}")
                tool = json.loads(client.recv())["inverse3"][0]
                place = [tool["state"]["cursor_position"][axis] for axis in "xyz"]
                if time.monotonic() - begin < 1.0:
                    first = place
                    continue
                assert first is not None
                self.looks += 1
                if max(abs(a - b) for a, b in zip(place, first, strict=True)) > MOVED:
                    self.faults["the pose moved"] += 1
                if tool["status"]["in_use"]:
                    self.faults["a session holds the device"] += 1
                if any(abs(force) > 0.0 for force in tool["state"]["current_cursor_force"].values()):
                    self.faults["a force was asked"] += 1

    def __exit__(self, *error: object) -> None:
        self.over.set()
        for thread in self.threads:
            thread.join(10.0)
        self.process.send_signal(signal.SIGINT)
        try:
            self.process.wait(30.0)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()


class Pages:
    """The pages of a recording, of a study's report and of found designs, in one process."""

    def __init__(self, recording: Path) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-c", PAGES, str(recording)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert self.process.stdout is not None
        self.ports, self.tokens = dict[str, int](), list[str]()
        for line in self.process.stdout:
            name, _, url = line.strip().partition(" ")
            found = re.fullmatch(r"http://127\.0\.0\.1:(\d+)/#?([A-Za-z0-9_-]+)/?", url)
            if found is None:
                raise SystemExit(f"no address of a page: {line}")
            self.ports[name] = int(found[1])
            self.tokens.append(found[2])
            if len(self.ports) == 3:
                break
        else:
            raise SystemExit("the pages did not start")
        time.sleep(1.0)

    def close(self) -> None:
        self.process.communicate(timeout=30.0)


class StudyRun:
    """A study whose participant's page waits."""

    def __init__(self, folder: Path) -> None:
        self.ports = {"study": free_port()}
        file = folder / "watched.toml"
        file.write_text(STUDY)
        self.process = subprocess.Popen(
            [sys.executable, "-c", COMMAND, "study", "run", str(file), "--db", str(folder / "watched.db"), "--port",
             str(self.ports["study"])],
            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, cwd=folder,
        )  # fmt: skip
        assert self.process.stderr is not None
        said, self.urls = "", dict[str, str]()
        while len(self.urls) < 2:
            line = self.process.stderr.readline()
            said += line
            if not line:
                raise SystemExit(f"the study did not start: {said[-2000:]}")
            who, _, url = line.strip().partition(":")
            if url.strip().startswith("http"):
                self.urls[who] = url.strip()
        self.tokens = [one.partition("#")[2] for one in self.urls.values()]
        self._stack = ExitStack()
        self._page = self._stack.enter_context(
            connect(f"ws://127.0.0.1:{self.ports['study']}/ws/participant", open_timeout=60)
        )
        self._page.send(self.tokens[0])

    def close(self) -> str:
        """End it; what its own page was told last if that is not the page that waits."""
        view: dict[str, Any] = {}
        with suppress(WebSocketException, TimeoutError):
            while True:
                told = json.loads(self._page.recv(timeout=1.0))
                view = told["is"] if told["event"] == "view" else view
        self._stack.close()
        self.process.send_signal(signal.SIGINT)
        self.process.communicate(timeout=30.0)
        fine = view.get("state") == "waiting" and not view["watching"]
        return "" if fine else f"the participant's page of this account: {view.get('state')}"


def free_port() -> int:
    with socket.socket() as tcp, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        tcp.bind(("127.0.0.1", 0))
        udp.bind(("127.0.0.1", tcp.getsockname()[1]))
        return int(tcp.getsockname()[1])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])  # type: ignore[union-attr]
    parser.add_argument("--attempts", type=int, default=1000)
    count = parser.parse_args().attempts
    if os.geteuid() != 0:
        print("only root can start a process of another account; run this as root")
        return 2
    tried, got = 0, Counter[str]()
    share = count // (len(RUNS) + 2)
    with tempfile.TemporaryDirectory() as folder:
        recording = Path(folder, "run.mcap")
        for host, tokens, sends in RUNS:
            with Run(host, tokens, None if recording.exists() else recording) as run:
                run.silent = not sends
                found = attack_as_another(share, run.ports, run.tokens)
            tried += found["tried"]
            got.update(found["got"])
            got.update(run.faults)
            print(
                f"tracker and OSC server at {host}, {'with' if tokens else 'no'} tokens, this account "
                f"{'sends' if sends else 'does not send'} poses: {found['tried']} attempts, "
                f"{sum(found['got'].values())} got something; {run.looks} looks at the device and {run.answers} OSC "
                "programs of this account"
            )
            if not run.looks:
                got["this account could not watch"] += 1
            if not run.answers:
                got["this account could not use the OSC server"] += 1
        study = StudyRun(Path(folder))
        found = attack_as_another(share, study.ports, study.tokens)
        tried += found["tried"]
        got.update(found["got"])
        if fault := study.close():
            got[fault] += 1
        print(f"pages of a study: {found['tried']} attempts, {sum(found['got'].values())} got something")
        pages = Pages(recording)
        found = attack_as_another(count - share * (len(RUNS) + 1), pages.ports, pages.tokens)
        tried += found["tried"]
        got.update(found["got"])
        pages.close()
        print(f"other pages: {found['tried']} attempts, {sum(found['got'].values())} got something")
    for what, times in got.items():
        print(f"{times} times: {what}")
    print(f"{sum(got.values())} of {tried} attempts of another account moved a coil, read a pose or a token")
    kept = not got and tried == count
    print("kept" if kept else "BROKEN")
    return 0 if kept else 1


if __name__ == "__main__":
    sys.exit(main())
