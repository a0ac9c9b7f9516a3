"""Who is connected: participants' pages through one door, experimenters' through another that wants a token."""

from __future__ import annotations

import asyncio
import json
import secrets
from collections.abc import Mapping
from contextlib import suppress
from typing import Any, final

from starlette.websockets import WebSocket, WebSocketDisconnect

from haptorb.apps.study.pages.reception import Reception
from haptorb.apps.study.pages.views import for_experimenter, for_participant, pen
from haptorb.apps.web.command import command as read_command
from haptorb.errors import HaptorbError, InputError

__all__ = ["Room"]

REFRESH = 1 / 100  #: between two refreshes of a pen that is steered from here [s]
FRAME = 1 / 25  #: between two looks at what there is to tell [s]
PATIENCE = 5.0  #: for an experimenter's token [s]

#: what a participant may ask of the reception; everything else steers, and steering is the experimenter's
_PARTICIPANT = frozenset({"agree", "answer", "reply", "skip", "interval"})
_EXPERIMENTER = frozenset({"begin", "pause", "resume", "repeat", "engage", "leave", "abort", "skip"})


@final
class Page:
    """One connected page."""

    def __init__(self, socket: WebSocket) -> None:
        self.socket = socket
        self.told: dict[str, Any] = {}  #: what it knows, by kind of event
        self.mistakes: list[str] = []


@final
class Room:
    """Joins pages to the reception."""

    def __init__(self, reception: Reception, token: str, about: Mapping[str, Any], more: Mapping[str, Any]) -> None:
        self._reception, self._token = reception, token
        self._about, self._more = dict(about), dict(more)
        self._participants: list[Page] = []  # the first has the pen and answers, the others only look on
        self._experimenters: list[Page] = []
        self._draft: Any = None
        self._draft_of = -1

    async def keep(self) -> None:
        """For as long as the server runs: the hand at rest on a pen that is steered from a page."""
        while True:
            stage = self._reception.stage
            if stage is not None:
                with suppress(HaptorbError):  # the reception's thread notices by itself, and says so
                    stage.hold()
            await asyncio.sleep(REFRESH)

    async def join_participant(self, socket: WebSocket) -> None:
        """Serve a participant's page until it goes away; a trial that runs is then paused, with the coils off."""
        await socket.accept()
        page = Page(socket)
        self._participants.append(page)
        await self._serve(page, self._hear_participant, self._about)
        first = self._participants[0] is page
        self._participants.remove(page)
        if first and self._reception.conduct is not None:
            self._reception.ask({"do": "pause", "why": "the participant's page was closed"}, lambda text: None)

    async def join_experimenter(self, socket: WebSocket) -> None:
        """Serve an experimenter's page, if its first message is the token."""
        await socket.accept()
        try:
            given = await asyncio.wait_for(socket.receive_text(), PATIENCE)
        except (TimeoutError, WebSocketDisconnect, KeyError, RuntimeError):
            given = ""
        if not secrets.compare_digest(given.encode(), self._token.encode()):
            with suppress(RuntimeError):
                await socket.close(1008, "this page needs the address that the terminal printed")
            return
        page = Page(socket)
        self._experimenters.append(page)
        await self._serve(page, self._hear_experimenter, self._about | self._more)
        self._experimenters.remove(page)

    async def _serve(self, page: Page, hear: Any, about: Mapping[str, Any]) -> None:
        sending = asyncio.create_task(self._send(page, about))
        try:
            while True:
                message = await page.socket.receive()
                if message["type"] == "websocket.disconnect":
                    break
                try:
                    hear(page, read_command(message.get("text") or ""))
                except HaptorbError as mistake:
                    page.mistakes.append(str(mistake))
        except (WebSocketDisconnect, RuntimeError):
            pass  # the page went away while something was on its way
        finally:
            sending.cancel()
            await asyncio.gather(sending, return_exceptions=True)

    def _hear_participant(self, page: Page, command: dict[str, Any]) -> None:
        if page is not self._participants[0]:
            raise InputError("another participant's page is open: close that one first")
        reception, do = self._reception, command.get("do")
        if do == "steer":
            stage = reception.stage
            if stage is not None and stage.steered:
                stage.aim(_number(command, "x"), _number(command, "y"))
        elif do == "draft":
            sitting = reception.sitting
            value = command.get("value")
            if isinstance(value, int) or value is None:
                self._draft, self._draft_of = value, sitting.number if sitting is not None else -1
        elif do == "stop":
            reception.ask({"do": "pause", "why": "by the participant"}, page.mistakes.append)
        elif do in _PARTICIPANT:
            reception.ask(command, page.mistakes.append)
        else:
            raise InputError(f"a participant's page may not do {do!r}")

    def _hear_experimenter(self, page: Page, command: dict[str, Any]) -> None:
        do = command.get("do")
        if do not in _EXPERIMENTER:
            known = ", ".join(sorted(_EXPERIMENTER))
            raise InputError(f"unknown command {do!r} (known: {known})")
        if do == "begin" and not isinstance(command.get("code"), str):
            raise InputError("a session begins with a participant's code, a text")
        self._reception.ask(command, page.mistakes.append)

    async def _send(self, page: Page, about: Mapping[str, Any]) -> None:
        """Whatever is new to `page`, some 25 times a second."""
        await page.socket.send_text(json.dumps({"event": "about", **about}))
        while True:
            reception = self._reception
            mine = page in self._participants
            events: dict[str, Any] = {}
            if mine:
                events["view"] = for_participant(reception) | {"watching": page is not self._participants[0]}
            else:
                sitting = reception.sitting
                draft = self._draft if sitting is not None and self._draft_of == sitting.number else None
                events["view"] = for_experimenter(reception, len(self._participants), draft)
            stage = reception.stage
            if stage is not None and (not mine or stage.simulated):
                with suppress(HaptorbError):
                    events["pen"] = pen(stage)
            for event, what in events.items():
                if page.told.get(event) != what:
                    page.told[event] = what
                    await page.socket.send_text(json.dumps({"event": event, "is": what}))
            while page.mistakes:
                await page.socket.send_text(json.dumps({"event": "mistake", "text": page.mistakes.pop(0)}))
            await asyncio.sleep(FRAME)


def _number(command: dict[str, Any], name: str) -> float:
    value = command.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{name} must be a number; got {value!r}")
    return float(value)
