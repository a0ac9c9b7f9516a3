"""WebSocket hub of the pages: participants' and experimenters', each with a token of its own.

Every page may stop. A message is checked for Stop first, which goes directly to the servo.
"""

from __future__ import annotations

import asyncio
import json
import secrets
from collections.abc import Mapping
from contextlib import suppress
from typing import Any, final

from starlette.websockets import WebSocket, WebSocketDisconnect

from haptorb.errors import HaptorbError, InputError
from haptorb.web.server import MAX_PAGES, TRY_AGAIN_LATER, PageAddress, is_request
from haptorb.web.server import command as read_command
from haptorb_study.pages.page_views import experimenter_view, participant_view, pen_view
from haptorb_study.pages.session_manager import SessionManager
from haptorb_study.pages.trial_viewers import TrialViewers
from haptorb_study.trial_lists import MAX_MAGNITUDE

__all__ = ["StudySocketHub"]


PEN_KEEP_ALIVE_S = 1 / 100  #: interval of the keep-alive of a pen steered from a page [s]
UPDATE_INTERVAL_S = 1 / 25  #: interval of state updates to the pages [s]
TOKEN_TIMEOUT_S = 5.0  #: timeout for a page's token [s]
MAX_WAITING = 32  #: connections whose token is awaited; a new one replaces the oldest

#: commands of a participant's page to the session manager; all others are the experimenter's
_PARTICIPANT_COMMANDS = frozenset({"agree", "answer", "reply", "skip", "interval"})
_EXPERIMENTER_COMMANDS = frozenset(
    {"begin", "pause", "stop", "resume", "repeat", "engage", "leave", "abort", "skip", "view"}
)
_IN_TRIAL = ("running", "time is up")
_MAX_UNSENT_MISTAKES = 20  #: unsent error messages of a page at most


@final
class StudyPage:
    """A connected page. `status`: the last value sent, by kind of event."""

    def __init__(self, socket: WebSocket, participant: bool) -> None:
        self.socket, self.participant = socket, participant
        self.status: dict[str, Any] = {}
        self.mistakes: list[str] = []

    def report(self, mistake: str) -> None:
        """Enqueue an error message for the page; only the newest are kept."""
        self.mistakes = [*self.mistakes[1 - _MAX_UNSENT_MISTAKES :], mistake]


@final
class StudySocketHub:
    """Connects the pages with the session manager."""

    def __init__(
        self, manager: SessionManager, token: str, participant_token: str, about: Mapping[str, Any],
        more: Mapping[str, Any], where: PageAddress = PageAddress(),
    ) -> None:  # fmt: skip
        self._manager, self._token, self._participant_token = manager, token, participant_token
        self._about, self._more = dict(about), dict(more)
        self._participants: list[StudyPage] = []  # the first controls, the others observe
        self._experimenters: list[StudyPage] = []
        self._waiting: list[asyncio.Task[str]] = []  # each for a token, the oldest first
        self.viewers = TrialViewers(where)  #: players of recorded trials, for the experimenter
        self._draft: Any = None
        self._draft_of = -1

    async def repeat_pen_goal(self) -> None:
        """Repeat the position of a pen steered from a page, so that it does not expire, as long as the server runs."""
        while True:
            trial_device = self._manager.trial_device
            if trial_device is not None:
                with suppress(Exception):  # the session thread detects and reports it itself
                    trial_device.repeat_goal()
            await asyncio.sleep(PEN_KEEP_ALIVE_S)

    async def join_participant(self, socket: WebSocket) -> None:
        """Serve a participant's page until it disconnects, if its first message is their token."""
        await socket.accept()
        if not await self._admits(socket, self._participant_token, self._participants):
            return
        page = StudyPage(socket, participant=True)
        self.register(page)
        try:
            await self._serve(page, self._about)
        finally:
            self.unregister(page)

    async def join_experimenter(self, socket: WebSocket) -> None:
        """Serve an experimenter's page until it disconnects, if its first message is their token."""
        await socket.accept()
        if not await self._admits(socket, self._token, self._experimenters):
            return
        page = StudyPage(socket, participant=False)
        self.register(page)
        try:
            await self._serve(page, self._about | self._more)
        finally:
            self.unregister(page)

    async def _admits(self, socket: WebSocket, token: str, pages: list[StudyPage]) -> bool:
        """Whether the first message is `token`, and there is room among `pages`; else the connection is closed."""
        given = await self._receive_token(socket)
        # safety: study-token
        if not secrets.compare_digest(given.encode("utf-8", "replace"), token.encode()):
            with suppress(RuntimeError):
                await socket.close(1008, "open this page with the address that the terminal printed")
            return False
        if len(pages) >= MAX_PAGES:
            with suppress(RuntimeError):
                await socket.close(TRY_AGAIN_LATER, f"{MAX_PAGES} pages are open already: close one of them")
            return False
        return True

    async def _receive_token(self, socket: WebSocket) -> str:
        """The first message of a page; empty if it sends none in time, or is replaced by newer connections."""
        receiving = asyncio.ensure_future(asyncio.wait_for(socket.receive_text(), TOKEN_TIMEOUT_S))
        while len(self._waiting) >= MAX_WAITING:
            self._waiting.pop(0).cancel()
        self._waiting.append(receiving)
        try:
            await asyncio.wait({receiving})
        finally:
            receiving.cancel()  # without effect where it has ended
            if receiving in self._waiting:
                self._waiting.remove(receiving)
        try:
            return receiving.result()
        except (TimeoutError, WebSocketDisconnect, KeyError, RuntimeError, asyncio.CancelledError):
            return ""

    def register(self, page: StudyPage) -> None:
        """Register `page`."""
        (self._participants if page.participant else self._experimenters).append(page)

    def unregister(self, page: StudyPage) -> None:
        """Unregister `page`. If it was the participant's, the coils are switched off until the session is resumed."""
        if page.participant and self._participants[0] is page:  # safety: participant-gone
            self._manager.halt.stop("the participant's page was closed")
        (self._participants if page.participant else self._experimenters).remove(page)

    def handle_message(self, page: StudyPage, text: str) -> None:
        """Process a message of `page`, Stop before anything else. Mistakes are reported to `page`, never raised."""
        try:
            if page.participant:
                if is_request(text, "stop"):  # safety: study-stop-first
                    self._manager.halt.stop("by the participant")
            elif is_request(text, "stop", "pause"):  # safety: study-pause-first
                self._manager.halt.stop("by the experimenter")
            elif is_request(text, "leave", "abort"):  # safety: study-end-first
                self._manager.halt.stop(None)
            command = read_command(text)
            do = command.get("do")
            if not isinstance(do, str):
                raise InputError("a command must state its action as text: do")
            if page.participant:
                self._receive_participant(page, do, command)
            else:
                self._receive_experimenter(page, do, command)
        except HaptorbError as mistake:
            page.report(str(mistake))
        # safety: study-message
        except Exception as fault:  # for any content: the page's next Stop must be received
            page.report(f"this message cannot be processed: {type(fault).__name__}")

    async def _serve(self, page: StudyPage, about: Mapping[str, Any]) -> None:
        sending = asyncio.create_task(self._send(page, about))
        try:
            while True:
                message = await page.socket.receive()
                if message["type"] == "websocket.disconnect":
                    break
                self.handle_message(
                    page, message.get("text") or (message.get("bytes") or b"").decode("utf-8", "replace")
                )
        except (WebSocketDisconnect, RuntimeError):
            pass  # the page disconnected during a transfer
        finally:
            sending.cancel()
            await asyncio.gather(sending, return_exceptions=True)

    def _receive_participant(self, page: StudyPage, do: str, command: dict[str, Any]) -> None:
        if do == "stop":
            return  # already done by `handle_message`
        if page is not self._participants[0]:
            raise InputError("another participant's page is open: close that one first")
        manager = self._manager
        if do == "steer":
            trial_device = manager.trial_device
            if trial_device is not None and trial_device.steered:
                trial_device.aim(_number(command, "x"), _number(command, "y"))
        elif do == "draft":
            session = manager.session
            value = command.get("value")
            if value is None or (type(value) in (int, float) and abs(value) <= MAX_MAGNITUDE):
                self._draft, self._draft_of = value, session.number if session is not None else -1
        elif do in _PARTICIPANT_COMMANDS:  # safety: participant-steers
            manager.enqueue(command, page.report)
        else:
            raise InputError(f"a participant's page may not do {do[:40]!r}")

    def _receive_experimenter(self, page: StudyPage, do: str, command: dict[str, Any]) -> None:
        if do not in _EXPERIMENTER_COMMANDS:
            known = ", ".join(sorted(_EXPERIMENTER_COMMANDS))
            raise InputError(f"unknown command {do[:40]!r} (known: {known})")
        if do == "begin" and not isinstance(command.get("code"), str):
            raise InputError("a session begins with a participant's code, a text")
        if do == "view":
            self._view(page, command.get("trial"))
        elif do not in ("stop", "pause"):
            self._manager.enqueue(command, page.report)

    def _view(self, page: StudyPage, trial: Any) -> None:
        """Play the recording of an answered trial of this session."""
        if self._manager.now in _IN_TRIAL:
            raise InputError("a trial is running: stop it, or wait for the pause after it, to play a recording")
        parts = [row.get("recording") for row in self._manager.log if row["trial"] == trial]
        if not parts or parts[-1] is None:
            raise InputError("this trial has no recording: it is not answered yet, or the session is not recorded")
        self.viewers.open(parts[-1], page.report)

    async def _send(self, page: StudyPage, about: Mapping[str, Any]) -> None:
        """Send state changes to `page`, about 25 times per second."""
        await page.socket.send_text(json.dumps({"event": "about", **about}))
        while True:
            for text in self._collect_messages(page):
                await page.socket.send_text(text)
            while page.mistakes:
                await page.socket.send_text(json.dumps({"event": "mistake", "text": page.mistakes.pop(0)}))
            await asyncio.sleep(UPDATE_INTERVAL_S)

    def _collect_messages(self, page: StudyPage) -> list[str]:
        """Messages with state changes for `page`; an exception in one does not block later ones."""
        news = []
        try:
            for event, what in self._events(page).items():
                if page.status.get(event) != what:
                    news.append(json.dumps({"event": event, "is": what}))
                    page.status[event] = what
        except Exception as fault:
            text = f"this page cannot be updated: {type(fault).__name__}: {fault}"
            if page.status.get("fault") != text:
                page.status["fault"] = text
                page.report(text)
        return news

    def _events(self, page: StudyPage) -> dict[str, Any]:
        """Current state for `page`, by kind of event."""
        manager = self._manager
        events: dict[str, Any] = {}
        if page.participant:
            events["view"] = participant_view(manager) | {"watching": page is not self._participants[0]}
        else:
            session = manager.session
            draft = self._draft if session is not None and self._draft_of == session.number else None
            events["view"] = experimenter_view(manager, len(self._participants), draft)
            events["viewers"] = self.viewers.urls
        trial_device = manager.trial_device
        if trial_device is not None and (not page.participant or trial_device.simulated):
            with suppress(HaptorbError):
                events["pen"] = pen_view(trial_device)
        return events


def _number(command: dict[str, Any], name: str) -> float:
    value = command.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{name} must be a number; got {str(value)[:40]!r}")
    try:
        return float(value)
    except OverflowError:
        raise InputError(f"{name} must be a smaller number") from None
