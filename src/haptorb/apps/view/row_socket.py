"""One page's socket: it asks for rows and worlds of a recording, and gets them in the console's frames."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Mapping
from typing import Any, final

from starlette.websockets import WebSocket, WebSocketDisconnect

from haptorb.apps.console.page import PATIENCE, to_json, wait_for_first
from haptorb.apps.console.wire import mesh_frame
from haptorb.apps.view.painted_worlds import PaintedWorlds
from haptorb.apps.view.played_recording import PlayedRecording
from haptorb.apps.web.command import command as read_command
from haptorb.apps.web.token import PROTOCOL
from haptorb.errors import HaptorbError, InputError

__all__ = ["MOST_ROWS", "RowSocket"]

MOST_ROWS = 4000  #: in one answer
_COMMANDS = "at, rows, world"


@final
class RowSocket:
    """Answers in the order of the questions; a force map comes when it is computed.

    {"do": "at", "n": N, "t": SECONDS} → one row, the last that is not later than SECONDS after the first tick
    {"do": "rows", "n": N, "first": ROW, "count": COUNT} → these rows, at most 4000
    {"do": "world", "change": CHANGE, "model": MODEL} → the event `world`, and its force map if it has one

    A mistake is answered with the event `mistake`, with the question's number.
    """

    def __init__(self, socket: WebSocket, recording: PlayedRecording, painted: PaintedWorlds | None) -> None:
        self._socket, self._recording, self._painted = socket, recording, painted
        self._wanted: tuple[int, str] | None = None
        self._changed = asyncio.Event()
        self._sending = asyncio.Lock()

    async def serve(self) -> None:
        """Until the page goes away, or does not take what it asked for."""
        await self._socket.accept(PROTOCOL if PROTOCOL in self._socket.scope["subprotocols"] else None)
        try:
            if self._painted is not None:
                await self._send(mesh_frame(self._painted.directions, self._painted.triangles))
            await wait_for_first(self._listen(), self._paint())
        except (WebSocketDisconnect, RuntimeError, TimeoutError):
            pass  # the page went away while something was on its way, or it does not listen

    async def _listen(self) -> None:
        while True:
            message = await self._socket.receive()
            if message["type"] == "websocket.disconnect":
                return
            question: Mapping[str, Any] = {}
            try:
                question = read_command(message.get("text") or "")
                await self._answer(question)
            except HaptorbError as mistake:
                number = question.get("n")
                await self._tell("mistake", text=str(mistake), n=number if _is_whole(number) else -1)
            await asyncio.sleep(0)  # however much one page asks, the others have their turn

    async def _answer(self, question: Mapping[str, Any]) -> None:
        match question["do"]:
            case "at":
                seconds = question.get("t")
                if not isinstance(seconds, int | float) or isinstance(seconds, bool):
                    raise InputError("`t` must be a number of seconds after the first tick")
                self._recording.overview.give_way()
                row = self._recording.find_row(float(seconds))
                await self._send(self._recording.frame(row, row + 1, _read_whole(question, "n")))
            case "rows":
                first, count = _read_whole(question, "first"), _read_whole(question, "count")
                if not 1 <= count <= MOST_ROWS:
                    raise InputError(f"`count` must be from 1 to {MOST_ROWS}; got {count}")
                await self._send(self._recording.frame(first, first + count, _read_whole(question, "n")))
            case "world":
                change, model = _read_whole(question, "change"), question.get("model")
                if not isinstance(model, str) or model not in self._recording.device.models:
                    raise InputError(f"`model` must be one of {', '.join(self._recording.device.models)}")
                await self._tell("world", change=change, **self._recording.describe_world(change, model))
                self._wanted = change, model
                self._changed.set()
            case other:
                raise InputError(f"unknown command {other!r} (known: {_COMMANDS})")

    async def _paint(self) -> None:
        """Send the map of the world that was asked for last."""
        while True:
            await self._changed.wait()
            self._changed.clear()
            if self._wanted is None or self._painted is None:
                continue
            change, model = self._wanted
            try:
                frame = await self._painted.paint(change, model)
            except HaptorbError as mistake:
                await self._tell("unpainted", change=change, text=f"no force map of this world: {mistake}")
                continue
            if frame is not None and self._wanted == (change, model):
                await self._send(frame)

    async def _send(self, frame: bytes) -> None:
        async with self._sending, asyncio.timeout(PATIENCE):
            await self._socket.send_bytes(frame)

    async def _tell(self, event: str, **what: Any) -> None:
        text = json.dumps({"event": event, **what}, allow_nan=False, default=to_json)
        async with self._sending, asyncio.timeout(PATIENCE):
            await self._socket.send_text(text)


def _is_whole(number: object) -> bool:
    return isinstance(number, int) and not isinstance(number, bool)


def _read_whole(question: Mapping[str, Any], key: str) -> int:
    number = question.get(key)
    if not isinstance(number, int) or isinstance(number, bool) or abs(number) > 2**53:
        raise InputError(f"`{key}` must be a whole number")
    return number
