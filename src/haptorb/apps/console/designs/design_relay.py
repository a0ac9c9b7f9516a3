"""Between pages and a session in which designs are felt: its commands one after another, its state to every page.

Everything of it waits for disk or servo in threads: nothing of a feel session may hold up a Stop.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any, final

from haptorb.apps.console.designs.design_session import DesignSession
from haptorb.apps.console.page import ConsolePage
from haptorb.errors import HaptorbError

__all__ = ["DesignRelay"]


@final
class DesignRelay:
    """The part of a hub that joins its `pages` to `designs`.

    notice_world   sends the world to the pages if it has changed
    """

    def __init__(self, designs: DesignSession, pages: list[ConsolePage], notice_world: Callable[[], None]) -> None:
        self._designs, self._pages, self._notice_world = designs, pages, notice_world
        self._version = -1  # as the pages know it
        self._choosing = asyncio.Lock()
        self._tasks: set[asyncio.Task[None]] = set()

    @property
    def hidden(self) -> bool:
        """Whether name, values and picture of the design are hidden from every page."""
        return self._designs.hidden

    def notice(self) -> None:
        """Tell everyone if page or terminal changed anything."""
        if self._designs.version != self._version:
            self._version = self._designs.version
            self._begin(self.tell(self._pages))

    def execute(self, page: ConsolePage, command: dict[str, Any]) -> None:
        """Do what `page` asks for, after what was asked before."""
        self._begin(self._execute(page, command))

    async def tell(self, pages: list[ConsolePage]) -> None:
        """Tell `pages` what is felt now."""
        try:
            now = await asyncio.to_thread(self._designs.describe)
        except HaptorbError as mistake:  # the file of ratings cannot be read any more
            for page in list(pages):
                page.tell("mistake", text=str(mistake))
            return
        for page in list(pages):
            page.tell("feel", **now)
        self._notice_world()

    async def _execute(self, page: ConsolePage, command: dict[str, Any]) -> None:
        async with self._choosing:
            try:
                await asyncio.to_thread(self._designs.execute, command)
            except HaptorbError as mistake:
                page.tell("mistake", text=str(mistake))
                await self.tell([page])

    def _begin(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
