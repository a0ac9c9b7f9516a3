"""Poses of one rigid body from a NatNet server (OptiTrack Motive), unicast; only that server's packets are accepted.

The package `natnet` decodes; the socket is our own, so that it listens only on the address that faces the server.
Motive must use the stator frame: its ground plane's origin in the device's centre, z up, the body's pivot in the tool's
magnet.
"""

from __future__ import annotations

import ipaddress
import select
import socket
import struct
from collections.abc import Iterator
from contextlib import suppress
from time import monotonic
from typing import Any, final

import numpy as np

from haptorb.errors import DriverError
from haptorb.runtime.sockets import DatagramTimes, UdpOwners, is_own_account
from haptorb.runtime.trackers.base import Feed, RawPose, RejectedPose
from haptorb.runtime.trackers.sender_clock import SenderClock

__all__ = ["PORT", "NatNetFeed", "natnet_socket"]

PORT = 1510  #: command port of a NatNet server

_CONNECT, _INFO, _FRAME, _KEEPALIVE = 0, 1, 7, 10
_TIMEOUT_S = 2.0  #: for a server's response
_KEEP_ALIVE_INTERVAL_S = 0.5  #: between two keep-alive messages to the server
_BURST = 64
_DOUBLE_TIME = (2, 7)  #: first protocol version whose frames have their time as a double
_NO_LATENCY = (3, 0)  #: first protocol version whose frames have no latency before the time, which `natnet` never reads
_PARAMETERS_BYTES = 2  #: bytes after the time in a frame of an earlier version


def _encode_request(kind: int, text: bytes = b"") -> bytes:
    return kind.to_bytes(2, "little") + (len(text) + 1).to_bytes(2, "little") + text + b"\0"


def _is_trusted(connected: socket.socket) -> bool:
    """Whether the peer of `connected` is a program of this account, or of another computer."""
    host, port = connected.getpeername()[:2]
    here = ipaddress.ip_address(host).is_loopback or connected.getsockname()[0] == host
    return not here or is_own_account(UdpOwners().find(host, port))


def natnet_socket(host: str, port: int = PORT, answer: float = _TIMEOUT_S) -> tuple[socket.socket, tuple[int, ...]]:
    """Connect to the NatNet server at `host`; return socket and protocol version. DriverError without a response."""
    from natnet.packet_buffer import PacketBuffer
    from natnet.server_info import ServerInfo
    from natnet.version import Version

    opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        opened.connect((host, port))  # the kernel then drops packets of others
        end = monotonic() + answer
        while (left := end - monotonic()) > 0:
            opened.send(_encode_request(_CONNECT, b"Ping"))
            if not select.select([opened], [], [], min(left, 0.25))[0]:
                continue
            try:
                data = opened.recv(65535)
                if int.from_bytes(data[:2], "little") == _INFO:
                    if not _is_trusted(opened):
                        raise DriverError(
                            f"tracker natnet: the server at {host}, UDP port {port}, is a program of another account "
                            "of this computer: end it, or run the tracker's program as this account"
                        )
                    info = ServerInfo.read_from_buffer(PacketBuffer(data[4:]), Version())
                    return opened, tuple(info.nat_net_protocol_version.components)
            except ConnectionRefusedError:
                break
            except DriverError:
                raise
            except Exception:  # not a server's response
                continue
        raise DriverError(
            f"tracker natnet: no NatNet server responds at {host}, UDP port {port}; switch on streaming (unicast) in "
            "Motive, and check its address"
        )
    except OSError as cause:
        opened.close()
        raise DriverError(
            f"tracker natnet: cannot reach '{host}': {cause.strerror}; check the address and the network"
        ) from cause
    except BaseException:
        opened.close()
        raise


@final
class NatNetFeed(Feed):
    """Receives the rigid body `body` (its streaming id; 0: the only one) through a connected socket."""

    def __init__(self, connected: socket.socket, version: tuple[int, ...], body: int = 0) -> None:
        from natnet.data_frame import DataFrame
        from natnet.packet_buffer import PacketBuffer
        from natnet.version import Version

        self._frame: Any = DataFrame
        self._buffer: Any = PacketBuffer
        self._version: Any = Version(*version)
        self._single = tuple(version) < _DOUBLE_TIME
        self._has_latency = tuple(version) < _NO_LATENCY
        self._socket, self._body = connected, body
        self._socket.setblocking(False)
        self._times = DatagramTimes()
        self._times.watch(connected)
        self._clock = SenderClock()
        self._missing = ""  # why the last frame has no pose
        self._alive = float("-inf")

    def receive(self, timeout: float) -> Iterator[RawPose | RejectedPose]:
        """Receive up to 64 packets; wait for the first for at most `timeout` [s]."""
        if monotonic() - self._alive > _KEEP_ALIVE_INTERVAL_S:
            self._alive = monotonic()
            with suppress(OSError):  # the server has ended: no more packets
                self._socket.send(_encode_request(_KEEPALIVE))
        select.select([self._socket], [], [], timeout)
        self._times.begin_batch()
        trusted: bool | None = None  # checked in each batch: another program may have taken over the server's port
        for _ in range(_BURST):
            try:
                data, notes, *_ = self._socket.recvmsg(65535, DatagramTimes.room)
            except BlockingIOError:
                return
            except OSError:
                continue
            if trusted is None:
                trusted = _is_trusted(self._socket)
            if not trusted:  # safety: natnet-account
                yield RejectedPose("another_account")
            elif int.from_bytes(data[:2], "little") == _FRAME:
                yield self.read(data, self._times.find(notes))

    def read(self, data: bytes, arrival: float) -> RawPose | RejectedPose:
        """Parse the body's pose in one frame; a frame without it means that it is lost."""
        try:
            buffer = self._buffer(data[4:])
            frame = self._frame.read_from_buffer(buffer, self._version)
            bodies = [one for one in frame.rigid_bodies if self._body in (0, one.id_num)]
            sent = self._read_time(buffer) if self._has_latency else float(frame.suffix.timestamp)
            resolution = float(np.spacing(np.float32(sent))) if self._single else 0.0
            stamp = self._clock.stamp(sent, arrival, resolution)
            self._missing = self._explain([int(one.id_num) for one in frame.rigid_bodies], bodies)
            if self._missing:
                return RawPose((), (), stamp, arrival, False)
            return RawPose(
                tuple(float(x) for x in bodies[0].pos), tuple(float(x) for x in bodies[0].rot), stamp, arrival
            )
        except Exception:  # a parser's failure on untrusted bytes
            return RejectedPose("garbage")

    def _read_time(self, buffer: Any) -> float:
        """Time of a frame before NatNet 3.0 [s]: `buffer` was read without its latency, and so ends 4 bytes early."""
        kind = struct.Struct("<f" if self._single else "<d")
        (sent,) = kind.unpack_from(buffer.data, buffer.pointer + 4 - _PARAMETERS_BYTES - kind.size)
        return float(sent)

    def _explain(self, known: list[int], bodies: list[Any]) -> str:
        """Explain why a frame with the rigid bodies `known` has no pose; empty if `bodies` is one that is tracked."""
        if not known:
            return "the server streams no rigid body"
        listed = ", ".join(map(str, known))
        if not bodies:
            return f"the server has no rigid body {self._body}; it streams {listed}"
        if len(bodies) > 1:
            return f"the server streams several rigid bodies, {listed}: name one, natnet:HOST/ID"
        return f"rigid body {bodies[0].id_num} is not tracked now" if bodies[0].tracking_valid is False else ""

    @property
    def remark(self) -> str:
        """Remark why there is no pose of the body, or why the server's times are not used; else empty."""
        return self._missing or self._clock.remark

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
