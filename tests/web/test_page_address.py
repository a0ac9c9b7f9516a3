"""Addresses of pages, permitted host names, and messages at the start."""

from __future__ import annotations

import socket

import pytest
from starlette.datastructures import Headers

from haptorb.errors import InputError
from haptorb.web.access import AccessGate
from haptorb.web.server import PageAddress, bind_socket, find_own_address


def test_an_address_for_each_way_to_a_page() -> None:
    assert PageAddress().url(8765) == "http://127.0.0.1:8765/"
    assert PageAddress("10.0.0.7").url(8765, "experimenter") == "http://10.0.0.7:8765/experimenter"
    assert PageAddress("0.0.0.0").url(1) == f"http://{find_own_address()}:1/"
    assert PageAddress("::1").url(1) == "http://[::1]:1/"
    behind = PageAddress(address="https://Lab.example/haptorb")
    assert behind.url(8765, "experimenter") == "https://Lab.example/haptorb/experimenter"
    assert behind.origin == "https://lab.example"


def test_a_page_for_others_is_warned_of() -> None:
    assert PageAddress().warning == ""
    assert "not encrypted" in PageAddress("0.0.0.0").warning
    assert "not encrypted" in PageAddress(address="http://lab/").warning
    secret = PageAddress(address="https://lab/").warning
    assert "Whoever has its whole address" in secret
    assert "not encrypted" not in secret


@pytest.mark.parametrize("words", [("a b", ""), ("127.0.0.1", "ftp://x/"), ("127.0.0.1", "https://x/?a=1"), ("", "x")])
def test_what_is_no_address_is_refused(words: tuple[str, str]) -> None:
    with pytest.raises(InputError, match=r"--host|--address"):
        PageAddress(*words)


LAB = "https://lab.example"


@pytest.mark.parametrize(
    ("host", "origin", "exposed", "public", "enters"),
    [
        ("127.0.0.1:9", None, False, "", True),
        ("localhost:9000", "http://localhost:9000", False, "", True),  # ssh -L
        ("10.0.0.7:8765", None, False, "", False),
        ("10.0.0.7:8765", "http://10.0.0.7:8765", True, "", True),
        ("[fe80::1]:8765", None, True, "", True),
        (socket.gethostname(), None, True, "", True),
        ("10.0.0.7:8765", "http://evil.example", True, "", False),
        ("evil.example", None, True, "", False),  # a name that was made to point to this computer
        ("lab.example", LAB, True, LAB, True),
        ("127.0.0.1:8765", LAB, True, LAB, True),  # a proxy that names the host behind it
        ("lab.example", "http://lab.example", True, "", False),
        ("lab.example", "https://evil.example", True, LAB, False),
        ("lab.example.evil.example", None, True, LAB, False),
    ],
)
def test_who_may_ask(host: str, origin: str | None, exposed: bool, public: str, enters: bool) -> None:
    headers = Headers({"host": host} | ({} if origin is None else {"origin": origin}))
    assert (AccessGate.refusal(headers, exposed, public) is None) == enters


def test_an_address_that_this_computer_has_not_is_one_message() -> None:
    with pytest.raises(InputError, match="--host"):
        bind_socket(0, "192.0.2.77")
    with bind_socket(0, "0.0.0.0") as opened:
        assert opened.getsockname()[0] == "0.0.0.0"
