"""`--serve osc:[HOST:]PORT`: one UDP port for what goes out and what comes in."""

from __future__ import annotations

import logging
import select
import socket
from time import monotonic, sleep
from typing import Any

from haptorb.apps.serve.access import choose_serve_token
from haptorb.apps.serve.osc.osc_session import OscSession
from haptorb.apps.serve.ports import LOOPBACK, check_port, is_loopback, open_port
from haptorb.apps.serve.preparation import ServerPreparation
from haptorb.apps.serve.served_device import ServedDevice
from haptorb.apps.serve.server_kinds import KINDS
from haptorb.errors import InputError

__all__ = ["FORM", "PORT", "prepare", "serve"]

FORM = KINDS["osc"].form
PORT = 9000  #: unless another is given

_LIVELY = 0.002  #: between two looks for rows while a client receives them [s]
_IDLE = 0.05  #: and while none does [s]
_FLOODED = 0.004  #: rest after a look that did not reach the end of what came [s]
_REPORT = 0.25  #: between two reports [s]


def prepare(where: str) -> ServerPreparation:
    """Understand [HOST:]PORT and open the port. Raises InputError if it cannot be had."""
    host, _, port = where.rpartition(":")
    host = host.strip("[]") or LOOPBACK
    number = check_port(port, FORM) if where else PORT
    token = choose_serve_token(host)
    try:
        opened = open_port(number, f"--serve {FORM}", host=host, datagrams=True)
    except UnicodeError as cause:
        raise InputError(f"--serve {FORM}: '{host}' is no address of this computer") from cause
    bound = opened.getsockname()[1]
    address = f"[{host}]:{bound}" if ":" in host else f"{host}:{bound}"
    beyond = not is_loopback(host)
    remarks = (f"OSC messages to {address} must begin with this token: {token}",) if beyond else ()
    return ServerPreparation(
        {"address": address, "token": token, "beyond": beyond}, f"osc.udp://{address}", [opened.detach()], remarks
    )


def serve(spec: dict[str, Any], descriptors: list[int], served: ServedDevice) -> None:
    """Serve until `served.over`; `spec` and `descriptors` are those of `prepare`."""
    logging.disable(logging.WARNING)  # python-osc logs what it does not know, and anybody may send that
    opened = socket.socket(fileno=descriptors[0])
    session = OscSession(opened, served, spec["token"], beyond=spec["beyond"])
    last = monotonic()
    while not served.over:
        select.select(session.sockets, [], [], _LIVELY if session.lively else _IDLE)
        flooded = session.read_messages()
        session.send(served.read_rows())
        now = monotonic()
        if now - last >= _REPORT:
            session.report(spec["address"], now - last)
            last = now
        if flooded:  # the processors belong to the loop first
            sleep(_FLOODED)
    session.report(spec["address"], max(monotonic() - last, 1e-3))
    session.close()
