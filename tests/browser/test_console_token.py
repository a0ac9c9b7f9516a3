"""The console's page with the printed address, without a token, with an old one, and when the server is full."""

from __future__ import annotations

import socket
from contextlib import ExitStack, suppress

import pytest
from websockets.sync.client import connect

pytestmark = [pytest.mark.browser, pytest.mark.realtime]


def cover_text(page) -> str:
    """What stands on the page instead of everything else."""
    page.locator("#lock-title").wait_for()
    assert page.locator("header").is_hidden()
    assert page.locator("#stop").is_hidden(), "no button that does nothing"
    return page.locator("#lock").inner_text()


def cut(connection: socket.socket) -> None:
    """End a connection without a word."""
    with suppress(OSError):  # it has ended
        connection.shutdown(socket.SHUT_RDWR)


def test_without_the_token_the_page_says_what_it_needs(browser, staged):
    console = staged.console
    page = browser.new_page()
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.goto(f"{console.origin}/")
    assert "the address that the terminal printed" in cover_text(page)
    assert not any("/api/" in url or "/ws" in url for url in asked)
    page.goto(f"{console.origin}/#of-an-earlier-run-0123")
    page.wait_for_timeout(500)
    assert "the address that the terminal printed" in cover_text(page)
    page.goto(console.url)  # pasted over it: only what is behind the # differs
    page.locator("#stop").wait_for()
    assert page.locator("#lock").is_hidden()
    page.reload()  # and reloading keeps it
    page.locator("#stop").wait_for()
    assert all(console.token not in url for url in asked), "no request tells it"
    page.close()


def test_a_seventeenth_page_waits_and_then_goes_on(browser, staged):
    console = staged.console
    address = f"ws://127.0.0.1:{console.port}/ws"
    shown = {"Authorization": f"Bearer {console.token}"}
    with ExitStack() as stack:
        others = []
        for _ in range(16):
            others.append(stack.enter_context(connect(address, additional_headers=shown, close_timeout=0.3)))
            # Cut, not closed: nobody reads what the server sends before its goodbye, and each would wait for that.
            stack.callback(cut, others[-1].socket)
        page = browser.new_page()
        page.goto(console.url)
        assert "16 pages are open already" in cover_text(page)
        others[7].close()
        page.locator("#stop").wait_for()
        page.close()
