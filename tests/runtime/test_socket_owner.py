"""Owner of the process at the other end of a socket: with another account, and with closed ends."""

from __future__ import annotations

import os
import socket
import time

import pytest

from haptorb.runtime import sockets
from haptorb.runtime.sockets import UdpOwners, is_own_account, listener_owner, tcp_owner
from oracles.other_account import NOBODY, as_nobody, needs_root


@pytest.fixture(params=["kernel", "table"])
def way(request, monkeypatch):
    """Both ways to know: the kernel is asked, or its table is read."""
    if request.param == "table":

        def refuse(*ends):
            raise OSError

        monkeypatch.setattr(sockets, "_find", refuse)


@pytest.fixture(params=["127.0.0.1", "::1"])
def listening(request):
    family = socket.AF_INET6 if ":" in request.param else socket.AF_INET
    with socket.socket(family) as made:
        try:
            made.bind((request.param, 0))
        except OSError:
            pytest.skip("no such loopback here")
        made.listen()
        yield made


def test_a_connection_of_this_account_is_its_own_until_its_end_is_closed(listening, way):
    with socket.create_connection(listening.getsockname()[:2]):
        taken, peer = listening.accept()
        assert tcp_owner(peer[:2], taken.getsockname()[:2]) == os.geteuid()
    assert tcp_owner(peer[:2], taken.getsockname()[:2]) is None  # the kernel would say root's
    taken.close()


@needs_root
def test_a_connection_of_another_account_is_seen(listening, way):
    with as_nobody(lambda: (socket.create_connection(listening.getsockname()[:2]), time.sleep(30))):
        taken, peer = listening.accept()
        with taken:
            assert tcp_owner(peer[:2], taken.getsockname()[:2]) == NOBODY
    assert not is_own_account(NOBODY)


def test_nobody_is_no_account():
    assert not is_own_account(None)
    assert is_own_account(os.geteuid())


def test_a_port_that_no_program_has_has_no_owner():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as opened:
        opened.bind(("127.0.0.1", 0))
        port = opened.getsockname()[1]
        assert UdpOwners().find("127.0.0.1", port) == os.geteuid()
    assert UdpOwners().find("127.0.0.1", port) is None


@needs_root
def test_a_port_of_two_accounts_is_nobodys():
    opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    opened.bind(("127.0.0.1", 0))
    port = opened.getsockname()[1]

    def share():
        other = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        other.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        other.bind(("0.0.0.0", port))
        time.sleep(30)

    with opened, as_nobody(share):
        end = time.monotonic() + 10.0
        while UdpOwners().find("127.0.0.1", port) is not None and time.monotonic() < end:
            time.sleep(0.01)
        assert UdpOwners().find("127.0.0.1", port) is None


@pytest.mark.parametrize("host", ["127.0.0.1", "0.0.0.0"])
def test_a_port_that_another_account_may_bind_too_is_nobodys(host):
    """Whoever bound it, sent and closed before anybody looked is in no table."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as opened:
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        opened.bind((host, 0))
        assert UdpOwners().find("127.0.0.1", opened.getsockname()[1]) is None
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 0)  # as of now nobody can
        assert UdpOwners().find("127.0.0.1", opened.getsockname()[1]) == os.geteuid()


@pytest.mark.skipif(not hasattr(socket, "SO_REUSEPORT"), reason="no such option")
def test_a_port_that_only_this_account_may_bind_again_is_its_own():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as opened:
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
        opened.bind(("127.0.0.1", 0))
        assert UdpOwners().find("127.0.0.1", opened.getsockname()[1]) == os.geteuid()


def test_a_listener_is_known_by_its_port(listening):
    assert listener_owner(listening.getsockname()[1]) == os.geteuid()
