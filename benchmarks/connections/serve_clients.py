"""Clients for `serve_haply.py`, each in a separate process.

    python benchmarks/connections/serve_clients.py TASK PORT [SECONDS]

Only the standard library, and a WebSocket of the least kind, so that the server's time is measured and not a client's.
What a client has to say comes as one line of JSON at its end.
"""

from __future__ import annotations

import json
import os
import socket
import struct
import sys
import time
from itertools import cycle
from threading import Thread


class Client:
    """One WebSocket on `port`; `received` is the inventory."""

    def __init__(self, port: int, origin: str = "") -> None:
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=10.0)
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        lines = [f"GET / HTTP/1.1\r\nHost: localhost:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade"]
        lines += ["Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13"]
        lines += [f"Origin: {origin}"] if origin else []
        self.socket.sendall(("\r\n".join(lines) + "\r\n\r\n").encode())
        self._pending = b""
        while b"\r\n\r\n" not in self._pending:
            self._fetch()
        head, _, self._pending = self._pending.partition(b"\r\n\r\n")
        if b" 101 " not in head.split(b"\r\n")[0]:
            raise ConnectionError(head.split(b"\r\n")[0].decode())
        self.inventory = json.loads(self.receive())
        self.device = self.inventory["inverse3"][0]["device_id"]

    def _fetch(self) -> None:
        data = self.socket.recv(65536)
        if not data:
            raise ConnectionError("closed")
        self._pending += data

    def send(self, message: bytes) -> None:
        """One text frame."""
        n = len(message)
        size = struct.pack("!BH", 0xFE, n) if n < 65536 else struct.pack("!BQ", 0xFF, n)
        size = bytes([0x80 | n]) if n < 126 else size
        self.socket.sendall(b"\x81" + size + b"\0\0\0\0" + message)

    def receive(self) -> bytes:
        """The next message."""
        while True:
            data = self._pending
            if len(data) >= 2:
                n, start = data[1] & 127, 2
                if n == 126 and len(data) >= 4:
                    n, start = struct.unpack("!H", data[2:4])[0], 4
                if n != 126 and len(data) >= start + n:
                    self._pending = data[start + n :]
                    if data[0] & 15 == 8:
                        raise ConnectionError("closed")
                    return data[start : start + n]
            self._fetch()

    def push(self, z: float) -> bytes:
        """Command `z` [N] upwards; returns the state."""
        force = {"set_cursor_force": {"vector": {"x": 0, "y": 0, "z": z}}}
        self.send(json.dumps({"inverse3": [{"device_id": self.device, "commands": force}]}).encode())
        return self.receive()


def answer(port: int, seconds: float, pause: float = 0.0) -> dict[str, object]:
    """Ask as fast as it is answered, or with a `pause`: each answer's time [ms]."""
    client, times = Client(port), list[float]()
    start = time.perf_counter()
    while (now := time.perf_counter()) < start + seconds:
        client.push(0.3)
        times.append(time.perf_counter() - now)
        if pause:
            time.sleep(pause)
    return {"times_ms": [1e3 * one for one in times], "per_second": len(times) / seconds}


def steps(port: int, seconds: float) -> dict[str, object]:
    """Another force every 100 ms: when each was sent, on the monotonic clock, and how large it is."""
    client, sent = Client(port), list[tuple[float, float]]()
    end, next_step, force = time.monotonic() + seconds, 0.0, 0.1
    while (now := time.monotonic()) < end:
        if now >= next_step:
            force, next_step = (0.3 if force == 0.1 else 0.1), now + 0.1
            sent.append((time.monotonic(), force))
        client.push(force)
        time.sleep(0.004)
    return {"sent": sent}


def hold(port: int, seconds: float) -> dict[str, object]:
    """0.5 N until somebody ends it; says when it has begun."""
    client = Client(port)
    client.push(0.5)
    print("holding", flush=True)
    while True:
        client.push(0.5)
        time.sleep(0.002)


def run_readers(port: int, seconds: float, count: int = 39) -> dict[str, object]:
    """Many clients that only look, twenty times a second each."""
    clients = [Client(port) for _ in range(count)]
    asked = worst = 0
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        begin = time.monotonic()
        for client in clients:
            client.send(b'{"inverse3":[{"device_id":null,"commands":{"probe_position":{}}}]}')
        for client in clients:
            json.loads(client.receive())
            asked += 1
        worst = max(worst, time.monotonic() - begin)
        time.sleep(max(0.0, 0.05 - (time.monotonic() - begin)))
    return {"clients": count, "answers": asked, "slowest_round_ms": 1e3 * worst}


def _attack(port: int, kind: str, end: float) -> None:
    start, rest = b'{"inverse3":[{"device_id":null,"commands":{"set_cursor_force":', b"}}]}"
    huge = start + b'{"vector":{"x":1e308,"y":1e308,"z":1e308}}' + rest
    none = start + b'{"values":{"x":NaN,"y":Infinity,"z":1e999}}' + rest
    while time.monotonic() < end:
        try:
            if kind == "foreign origin":
                Client(port, "https://evil.example")
            client = Client(port)
            while time.monotonic() < end:
                match kind:
                    case "bad JSON":
                        client.send(b'{"inverse3":[{"commands":' + b"[" * 2000)
                        client.receive()
                    case "8 MB frames":
                        client.send(b"x" * 8_000_000)
                    case "numbers":
                        for message in (huge, none):
                            client.send(message)
                            client.receive()
                    case "never reading":
                        client.send(huge)
        except OSError:
            time.sleep(0.01)


def run_attackers(port: int, seconds: float) -> dict[str, object]:
    """Ten hostile clients, two of each kind."""
    kinds = ["bad JSON", "8 MB frames", "foreign origin", "numbers", "never reading"]
    end = time.monotonic() + seconds
    threads = [Thread(target=_attack, args=(port, kind, end), daemon=True) for kind, _ in zip(cycle(kinds), range(10))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(max(0.0, end + 2.0 - time.monotonic()))
    return {"clients": 10}


if __name__ == "__main__":
    task, port, seconds = sys.argv[1], int(sys.argv[2]), float(sys.argv[3])
    tasks = {"answer": answer, "steps": steps, "hold": hold, "friends": run_readers, "foes": run_attackers}
    found = answer(port, seconds, 0.005) if task == "paced" else tasks[task](port, seconds)
    print(json.dumps(found), flush=True)
    os._exit(0)
