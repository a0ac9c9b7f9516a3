"""Ports of servers: opened with an error that says who has them and what to do."""

from __future__ import annotations

import errno
import ipaddress
import socket
from contextlib import suppress
from pathlib import Path

from haptorb.errors import InputError

__all__ = [
    "LOOPBACK",
    "OTHER_LOOPBACK",
    "check_port",
    "has_other_loopback",
    "is_loopback",
    "open_port",
    "port_owner",
]

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
