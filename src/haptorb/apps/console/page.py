"""One connected page: its socket, and what it has not got yet; who does not listen is left."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Coroutine
from typing import Any, final

import numpy as np
from starlette.websockets import WebSocket

__all__ = ["PATIENCE", "ConsolePage", "to_json", "wait_for_first"]

PATIENCE = 5.0  #: for a page that does not take what is sent [s]


@final
class ConsolePage:
    """Of every kind of event only the newest waits to be sent, so a slow page costs no more than a quick one."""

    def __init__(self, socket: WebSocket) -> None:
        self.socket = socket
        self.events: dict[str, dict[str, Any]] = {}
        self.force_version = -1  #: version of the force map that it has
        self.dropped = 0  #: rows that it will never get
        self.soon = asyncio.Event()  #: something is worth sending before the frame is full

    def tell(self, event: str, **what: Any) -> None:
        """Send `event`; a newer one of the same kind replaces it if it has not left yet."""
        self.events[event] = {"event": event, **what}
        self.soon.set()

    async def send_events(self) -> None:
        """Every message to the page; TimeoutError as in `send`."""
        while self.events:
            event = self.events.pop(next(iter(self.events)))
            async with asyncio.timeout(PATIENCE):
                await self.socket.send_text(json.dumps(event, allow_nan=False, default=to_json))
            await asyncio.sleep(0)  # if that failed, the server sees it now

    async def send(self, frame: bytes) -> None:
        """One frame; TimeoutError if the page has not taken the earlier ones after five seconds."""
        async with asyncio.timeout(PATIENCE):
            await self.socket.send_bytes(frame)
        await asyncio.sleep(0)


def to_json(value: Any) -> Any:
    """`value` as JSON has it."""
    if isinstance(value, tuple | list | np.ndarray):
        return [float(number) for number in value]
    return value.item() if isinstance(value, np.generic) else value


async def wait_for_first(*ways: Coroutine[Any, Any, None]) -> None:
    """Until one of `ways` ends; the others are cancelled."""
    tasks = [asyncio.create_task(way) for way in ways]
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    for task in done:
        task.result()
