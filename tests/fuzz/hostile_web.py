"""Attacks on a console in use, by programs of another account and by pages that do not read.

    python tests/fuzz/hostile_web.py [--connections 1000] [--seconds 10] [--json]

Starts the simulated Omni with its console, as `haptorb run` does, and a page that moves the stylus. A program of
another account (of the same one, where this one may not become another) asks for everything that there is, and says
what it was answered. Then it opens the connections, a tenth of each kind: silent ones, half a handshake, a header that
never ends, garbage, sockets without the token, with a wrong one, with a foreign Origin, with a foreign Host, requests
whose answer is never read, requests of 60 kB; and 200 pages with the token that never read. It holds them as long as
it is let.

The last line is the verdict: 403 for the other account, no trip, less than 100 MB more memory in the console's process,
no more open connections than 16 pages, 32 requests and 32 sockets that open or close, as the kernel counts them, and
the page that moves the stylus was answered to the end. On a computer that is too busy for the loop without any of
this nothing is said.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import math
import multiprocessing
import os
import random
import resource
import statistics
import struct
import subprocess
import sys
import threading
import time
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

PAGES = 200  #: with the token, that never read
OPEN = 16 + 32 + 32  #: connections that the console may hold at once
MEMORY = 100.0  #: more than this is too much [MB]
NOBODY = 65534

HALF = b"GET /api/session HTTP/1.1\r\nHost: 127.0.0.1\r\n"
UPGRADE = (
    b"GET /ws HTTP/1.1\r\nConnection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
    b"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n"
)
HERE = b"Host: 127.0.0.1\r\n"
STOP = b"\x81\x8e\0\0\0\0" + b'{"do": "stop"}'

#: what each kind of connection says, and whether it listens to the answer
KINDS: dict[str, tuple[bytes, bool]] = {
    "silent": (b"", True),
    "half a handshake": (UPGRADE + HERE, True),
    "an endless header": (HALF + b"X: " + b"y" * 60_000, True),
    "garbage": (bytes(range(256)) * 40, True),
    "no token": (UPGRADE + HERE + b"\r\n" + STOP, True),
    "a wrong token": (UPGRADE + HERE + b"Authorization: Bearer 0123456789abcdef012345\r\n\r\n" + STOP, True),
    "a foreign origin": (UPGRADE + HERE + b"Origin: http://[\r\n\r\n" + STOP, True),
    "a foreign host": (UPGRADE + b"Host: evil.example\r\n\r\n" + STOP, True),
    "never reads": (b"GET /static/console.js HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n" * 20, False),
    "a large request": (
        b"POST /api/session HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 60000\r\n\r\n" + b"z" * 60_000,
        True,
    ),
}


def attack(port: int, connections: int, seconds: float, token: str = "", pages: int = 0) -> dict[str, int]:
    """Open all of them within half of `seconds`, hold each for `seconds` or as long as it is let.

    Returns how often which status was answered ("none": the connection ended without one; "held": to the end).
    """

    async def one(words: bytes, listens: bool, begin: float) -> str:
        status = "none"
        await asyncio.sleep(begin)
        try:
            reader, writer = await asyncio.open_connection("127.0.0.1", port, limit=4096)
        except OSError:
            return "not taken"
        try:
            async with asyncio.timeout(seconds):
                writer.write(words)
                if not listens:
                    reader._transport.pause_reading()  # type: ignore[attr-defined]
                    await asyncio.sleep(seconds)
                line = await reader.readline()
                if line.startswith(b"HTTP/1.1 "):
                    status = line.split()[1].decode()
                while await reader.read(4096):
                    if status == "101":  # a page: it says nothing, and hears no more
                        reader._transport.pause_reading()  # type: ignore[attr-defined]
                        await asyncio.sleep(seconds)
        except TimeoutError:
            status = "held" if status == "none" and listens else status
        except (OSError, ValueError):
            pass
        finally:
            writer.transport.abort()
        return status

    async def all_of_them() -> list[str]:
        page = UPGRADE + HERE + f"Authorization: Bearer {token}\r\n\r\n".encode()
        words = [*KINDS.values()]
        wanted = [words[k % len(words)] for k in range(connections)] + [(page, True)] * pages
        random.Random(7).shuffle(wanted)
        step = 0.5 * seconds / len(wanted)  # one after another, so that every one has the chance to be answered
        return list(await asyncio.gather(*(one(*each, k * step) for k, each in enumerate(wanted))))

    counts: dict[str, int] = {}
    for status in asyncio.run(all_of_them()):
        counts[status] = counts.get(status, 0) + 1
    return counts


def ask_without_token(port: int) -> dict[str, int]:
    """What somebody without the token is answered, by what was asked for."""
    import socket

    guess = b"Authorization: Bearer 0123456789abcdef012345\r\n"
    found = {}
    for name, words in {
        "numbers": HALF + b"\r\n",
        "numbers, guessing": HALF + guess + b"\r\n",
        "socket": UPGRADE + HERE + b"\r\n",
        "socket, guessing": UPGRADE + HERE + guess + b"\r\n",
    }.items():
        with socket.socket() as one:
            one.settimeout(20)
            one.connect(("127.0.0.1", port))
            one.sendall(words)
            one.sendall(STOP)
            found[name] = int(one.recv(1000).split()[1])
    return found


def another() -> dict[str, Any]:
    """In a process of its own, as another account if that may be: all of it; what it is to do is in the arguments."""
    port, connections, seconds, token, pages = json.loads(sys.argv[2])
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(hard, max(soft, 2 * (connections + pages) + 64)), hard))
    asyncio.run(asyncio.sleep(0))  # what is loaded late is loaded while it may be read
    "".encode("idna")
    if os.getuid() == 0:
        os.setgroups([])
        os.setgid(NOBODY)
        os.setuid(NOBODY)
    if not connections:
        return {"uid": os.getuid(), **ask_without_token(port)}
    return attack(port, connections, seconds, token, pages)


def _other(port: int, connections: int = 0, seconds: float = 0.0, token: str = "", pages: int = 0) -> dict[str, Any]:
    what = json.dumps([port, connections, seconds, token, pages])
    done = subprocess.run([sys.executable, __file__, "--another", what], stdout=subprocess.PIPE, text=True, check=True)
    return dict(json.loads(done.stdout))


def serve(line: Connection) -> None:
    """The console and its servo; says where it is, and at the end how it went."""
    from haptorb.runtime.servo import Servo
    from haptorb.web.console import Console

    servo = Servo("omni", "dome", record=False)
    with Console(servo, 0) as console, servo:
        line.send((console.port, console.token))

        asked = threading.Event()

        def answer() -> None:
            with contextlib.suppress(EOFError):  # the measuring program has gone
                while line.recv() == "trips":
                    line.send([trip["reason"] for trip in servo.report()["trips"]])
            asked.set()
            console.close()

        threading.Thread(target=answer, daemon=True).start()
        console.serve()
        if not asked.is_set():
            servo.check()  # a servo that ended by itself says why


class Holder:
    """A page that moves the stylus a little every 12 ms, as keys do, and measures the way to the answer.

    Between two moves it is the server that keeps the hand's pose fresh, and that is what is tried: a drag also ends
    when the computer has no time for the dragging page for a fifth of a second, whatever the server does.
    """

    def __init__(self, port: int, token: str) -> None:
        self._socket = connect(f"ws://127.0.0.1:{port}/ws", additional_headers={"Authorization": f"Bearer {token}"})
        self.answers: list[tuple[float, float]] = []  # when, and after how long [s]
        self.control = self.ended = False
        self._over = threading.Event()
        self._threads = [threading.Thread(target=each, daemon=True) for each in (self._hear, self._hold)]
        for thread in self._threads:
            thread.start()

    def _hear(self) -> None:
        try:
            for message in self._socket:
                now = time.monotonic()
                if isinstance(message, str):
                    event = json.loads(message)
                    self.control = event["control"] if event["event"] == "role" else self.control
                elif message[4:6] == b"\x01\0" and math.isfinite(echo := struct.unpack("<d", message[32:40])[0]):
                    self.answers.append((now, now - 1e-3 * echo))
        except ConnectionClosed:
            pass
        self.ended = not self._over.is_set()

    def _hold(self) -> None:
        k = 0
        while not self._over.wait(0.012):
            k += 1
            x = 0.004 * math.sin(0.02 * k)
            stamp = 1e3 * time.monotonic()
            with contextlib.suppress(ConnectionClosed):  # heard there
                self._socket.send(struct.pack("<9d", stamp, x, 0.0, 0.047, *[math.nan] * 4, 0.0))

    def close(self) -> None:
        """Let go."""
        self._over.set()
        self._threads[1].join()
        self._socket.close()


def _memory(process: int) -> float:
    """What the process has in memory [MB]."""
    for line in Path(f"/proc/{process}/status").read_text().splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1]) / 1024
    return 0.0


def _count_connections(port: int) -> int:
    """Connections to `port` that its program holds, as the kernel counts them."""
    lines = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    # the local port, established or half closed, and taken from the queue: it has an inode
    return sum(int(one[1].split(":")[1], 16) == port and one[3] in ("01", "08") and one[9] != "0" for one in lines)


def _times(answers: list[tuple[float, float]]) -> dict[str, float]:
    times = sorted(1e3 * way for _, way in answers)
    if not times:
        return {"median_ms": math.inf, "worst_ms": math.inf}
    return {"median_ms": round(statistics.median(times), 1), "worst_ms": round(times[-1], 1)}


def measure(connections: int, seconds: float) -> dict[str, Any]:
    """What came of it."""
    line, other = multiprocessing.get_context("spawn").Pipe()
    serving = multiprocessing.get_context("spawn").Process(target=serve, args=(other,))
    serving.start()
    other.close()
    port, token = line.recv()
    assert serving.pid is not None
    holder = Holder(port, token)
    try:
        time.sleep(3.0)  # the felt map is painted, everything has been loaded
        line.send("trips")
        ignored = len(line.recv())  # while it was starting
        holder.answers.clear()
        time.sleep(seconds)
        quiet = _times(list(holder.answers))
        line.send("trips")
        busy = line.recv()[ignored:]
        stranger = _other(port)
        holder.answers.clear()
        before = peak = _memory(serving.pid)
        counts: list[int] = []
        found: dict[str, Any] = {}
        attacking = threading.Thread(
            target=lambda: found.update(_other(port, connections, seconds, token, PAGES)), daemon=True
        )
        attacking.start()
        while attacking.is_alive():
            peak = max(peak, _memory(serving.pid))
            counts.append(_count_connections(port))
            time.sleep(0.02)
        start = time.monotonic()
        time.sleep(1.0)
        line.send("trips")
        trips = line.recv()[ignored + len(busy) :]
        answered = any(when > start for when, _ in holder.answers)
        return {
            "another_account": stranger,
            "hostile_answers": found,
            "memory_before_mb": round(before, 1),
            "memory_growth_mb": round(peak - before, 1),
            # held for a tenth of a second: what has just been taken, to be ended, does not count
            "connections": max((min(counts[k : k + 5]) for k in range(len(counts) - 4)), default=0),
            "trips_without": busy,
            "trips": trips,
            "control_kept": holder.control and not holder.ended and answered,
            "quiet": quiet,
            "hostile": _times(holder.answers),
        }
    finally:
        holder.close()
        with contextlib.suppress(OSError):  # it ended by itself, and said why
            line.send("end")
        serving.join(20)
        if serving.is_alive():
            serving.kill()


def main() -> int:
    """Print what was measured; 0 if it is what is promised, 1 if not, 2 if this computer is too busy to say."""
    if sys.argv[1:2] == ["--another"]:
        print(json.dumps(another()))
        return 0
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--connections", type=int, default=1000)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    given = parser.parse_args()
    try:
        result = measure(given.connections, given.seconds)
    except (EOFError, BrokenPipeError):
        print("nothing can be said: the loop ended by itself; its reason stands above")
        return 2
    if given.json:
        print(json.dumps(result))
    else:
        for name, value in result.items():
            print(f"{name:>18}  {value}")
    codes = {value for name, value in result["another_account"].items() if name != "uid"}
    wrong = [
        *(["another account was answered other than 403"] if codes != {403} else []),
        *([f"{len(result['trips'])} trips"] if result["trips"] else []),
        *(["too much memory"] if result["memory_growth_mb"] >= MEMORY else []),
        *(["too many connections"] if result["connections"] > OPEN else []),
        *([] if result["control_kept"] else ["the page that moved the stylus lost the control"]),
    ]
    if result["trips_without"] and wrong:
        print("nothing can be said: the loop tripped on this computer before anything hostile was done")
        return 2
    print(
        f"not as promised: {', '.join(wrong)}" if wrong else "as promised: 403, no trip, memory bounded, control kept"
    )
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
