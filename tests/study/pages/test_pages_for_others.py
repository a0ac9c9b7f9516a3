"""`haptorb study run --host`: other computers need the token of the page that they open."""

from __future__ import annotations

import json
import socket
from collections.abc import Callable, Iterator
from pathlib import Path

import httpx
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.frames import Close
from websockets.sync.client import connect

from haptorb.errors import InputError
from haptorb.web.server import PageAddress
from haptorb_study.study_file import study_of
from study.pages.test_pages import STUDY, StudyHost

pytestmark = pytest.mark.realtime
PAGES = ["participant", "experimenter"]
CLOSED = str(Close(1008, "open this page with the address that the terminal printed"))


@pytest.fixture
def serve(tmp_path: Path) -> Iterator[Callable[[str], StudyHost]]:
    hosts: list[StudyHost] = []

    def start(host: str) -> StudyHost:
        hosts.append(StudyHost(study_of(STUDY), tmp_path / "s.db", PageAddress(host)))
        return hosts[-1]

    yield start
    for host in hosts:
        host.close()


def hear(url: str, token: str | None) -> str:
    """The first event that a page at `url` gets; how it is refused, if it is."""
    with connect(url, proxy=None) as page:
        try:
            if token is not None:
                page.send(token)
            return str(json.loads(page.recv(timeout=10))["event"])
        except ConnectionClosed as end:
            return str(end.rcvd)


@pytest.mark.parametrize("page", PAGES)
def test_from_another_address_only_with_the_token(page: str, serve: Callable[[str], StudyHost]) -> None:
    """127.0.0.2 is an address of this computer at which the pages do not listen unless they are asked to."""
    host = serve("0.0.0.0")
    url = f"127.0.0.2:{host.host.port}"
    token, other = (getattr(host.host, name).partition("#")[2] for name in (page, PAGES[page == PAGES[0]]))
    assert len({token, other, ""}) == 3
    for wrong in ("x" * len(token), "none", other):
        assert hear(f"ws://{url}/ws/{page}", wrong) == CLOSED
    assert hear(f"ws://{url}/ws/{page}", token) == "about"
    with pytest.raises(InvalidStatus) as refused:
        connect(f"ws://{url}/ws/{page}", origin="http://evil.example", proxy=None).close()  # type: ignore[arg-type]
    assert refused.value.response.status_code == 403
    assert httpx.get(f"http://{url}/", headers={"host": "evil.example"}).status_code == 403


def test_alone_on_this_computer_no_other_address_answers(serve: Callable[[str], StudyHost]) -> None:
    with pytest.raises(OSError, match="refused"):
        connect(f"ws://127.0.0.2:{serve('127.0.0.1').host.port}/ws/participant", proxy=None).close()


@pytest.mark.skipif(not socket.has_dualstack_ipv6(), reason="this computer has no IPv6")
@pytest.mark.parametrize("address", ["::1", "::"])
def test_ipv6(address: str, serve: Callable[[str], StudyHost]) -> None:
    host = serve(address).host
    token = host.participant.partition("#")[2]
    assert hear(f"ws://[::1]:{host.port}/ws/participant", token) == "about"


@pytest.mark.parametrize("name", ["no-such-computer.invalid", "192.0.2.77", "256.0.0.1"])
def test_what_is_no_address_of_this_computer_is_refused_before_anybody_sits_down(
    name: str, serve: Callable[[str], StudyHost]
) -> None:
    with pytest.raises(InputError, match="--host") as told:
        serve(name)
    assert name in str(told.value)
    assert "\n" not in str(told.value)
