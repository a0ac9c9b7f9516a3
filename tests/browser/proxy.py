"""Proxy in front of a page: HTTPS, a path, another port, and a server that is unreachable for a while."""

from __future__ import annotations

import socket
import ssl
import threading
from contextlib import suppress
from pathlib import Path

PREFIX = "/user/ann/proxy/8765"


class Proxy:
    """Passes what comes for `prefix` on to a port, without the prefix; one request for each connection, or a socket."""

    def __init__(self, prefix: str, certificate: Path | None = None) -> None:
        self._prefix, self.target = prefix.encode(), 0
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._listening.getsockname()[1])
        self._context = None
        if certificate is not None:
            self._context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
            self._context.load_cert_chain(certificate)
        self._running = threading.Event()
        self._running.set()
        self._open: list[socket.socket] = []
        self._upgraded: set[socket.socket] = set()
        threading.Thread(target=self._accept, daemon=True).start()

    def pause(self) -> None:
        """End every connection, and answer no new one. Web sockets are last: at their end the page asks anew, and if
        its question took another connection that ends now, it would hear of a server that has gone."""
        self._running.clear()
        for one in sorted(self._open, key=self._upgraded.__contains__):
            with suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)

    def go_on(self) -> None:
        """Answer again, also those that have waited."""
        self._running.set()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                connection, _ = self._listening.accept()
                self._open.append(connection)
                self._running.wait()
                threading.Thread(target=self._serve, args=(connection,), daemon=True).start()

    def _serve(self, plain: socket.socket) -> None:
        with (
            suppress(OSError),
            plain,
            self._context.wrap_socket(plain, server_side=True) if self._context else plain as front,
        ):
            head = b""
            while b"\r\n\r\n" not in head:
                if not (more := front.recv(65536)):
                    return
                head += more
            first, _, rest = head.partition(b"\r\n")
            word, path, version = first.split(b" ")
            assert path.startswith(self._prefix + b"/"), path
            if b"upgrade: websocket" not in rest.lower():
                rest = b"Connection: close\r\n" + rest.replace(b"Connection: keep-alive\r\n", b"")
            else:
                self._upgraded.add(plain)
            with socket.create_connection(("127.0.0.1", self.target)) as back:
                back.sendall(b" ".join([word, path[len(self._prefix) :], version]) + b"\r\n" + rest)
                up = threading.Thread(target=self._copy, args=(front, back), daemon=True)
                up.start()
                self._copy(back, front)
                with suppress(OSError):
                    front.shutdown(socket.SHUT_RDWR)

    @staticmethod
    def _copy(source: socket.socket, sink: socket.socket) -> None:
        with suppress(OSError):
            while data := source.recv(65536):
                sink.sendall(data)

    def close(self) -> None:
        self._listening.close()
