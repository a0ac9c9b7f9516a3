"""Values of --serve, and their effect on the world."""

from __future__ import annotations

import re
import socket
import subprocess
import sys

import pytest
import typer

from haptorb.cli.program import app
from haptorb.errors import DriverError, InputError, UnknownName
from haptorb.serve.base import (
    KINDS,
    ServerKind,
    add_client_force,
    check_servers,
    is_client_force_alone,
    load_kind,
    open_port,
)
from haptorb.serve.haply import prepare
from haptorb.web.access import SERVE_TOKEN, Access, choose_serve_token
from haptorb.worlds import Dome, Remote, Terrain
from haptorb.worlds.user_world import parse_world_file


def test_a_kind_that_there_is_not_and_two_of_one_kind_are_refused():
    with pytest.raises(UnknownName, match=re.escape("haply[:HOST][:PORT[:EVENTS]]")):
        check_servers(["haplly"])
    with pytest.raises(InputError, match="twice"):
        check_servers(["haply", "haply:12001"])
    assert check_servers([]) == ()


def test_help_names_every_form():
    (option,) = [one for one in typer.main.get_command(app).commands["run"].params if one.name == "serve"]
    assert all(kind.form in option.help for kind in KINDS.values())


def test_the_clients_force_is_felt_alone_or_added_to_what_was_chosen(tmp_path):
    haply = check_servers(["haply"])
    assert is_client_force_alone(haply)
    assert not is_client_force_alone(())
    assert add_client_force(Remote(limit=2.0), haply) == Remote(limit=2.0)
    assert isinstance(add_client_force(Terrain(), haply).parts[1], Remote)
    assert add_client_force(Dome(), ()) == Dome()
    (tmp_path / "mine.py").write_text("import numpy as np\ndef mine(state):\n    return np.ones(6)\n")
    mine = parse_world_file(f"{tmp_path}/mine.py:mine")
    loaded = add_client_force(mine, haply).load()
    assert (loaded.parts[0].name, loaded.parts[1]) == ("mine", Remote())
    assert add_client_force(mine, ()) == mine


@pytest.mark.parametrize("where", ["x", "70000", "-1", "10001:y", "1:2:3:4:nine"])
def test_an_address_that_is_none_says_what_was_expected(where):
    with pytest.raises(InputError):
        prepare(where).close()


def test_a_port_in_use_says_who_has_it_and_how_to_take_another():
    code = "import socket,sys; s=socket.create_server(('127.0.0.1',0)); print(s.getsockname()[1],flush=True); input()"
    with subprocess.Popen([sys.executable, "-S", "-c", code], stdin=-1, stdout=-1, text=True) as other:
        assert other.stdout is not None
        port = int(other.stdout.readline())
        try:
            with pytest.raises(InputError) as refusal:
                prepare(f"{port}:0")
        finally:
            other.kill()
    text = str(refusal.value)
    assert f"port {port}" in text
    assert f"process {other.pid}" in text
    assert "--serve haply:PORT" in text


def test_a_datagram_port_in_use_is_told_the_same_way():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        with pytest.raises(InputError, match="in use by"):
            open_port(other.getsockname()[1], "--serve osc:HOST:PORT", datagrams=True)


def test_a_missing_package_says_what_to_install(monkeypatch):
    monkeypatch.setitem(KINDS, "none", ServerKind("none", "haptorb.no_module", "no_such_package", "unchanged"))
    with pytest.raises(DriverError, match=re.escape("pip install 'haptorb[serve]'")):
        load_kind("none")


def test_a_token_is_made_for_other_computers_and_may_be_set_for_other_accounts(monkeypatch):
    monkeypatch.delenv(SERVE_TOKEN, raising=False)
    assert choose_serve_token("127.0.0.1") == choose_serve_token("localhost") == ""
    assert len(choose_serve_token("0.0.0.0")) >= 16
    monkeypatch.setenv(SERVE_TOKEN, "a-token-that-stays")
    assert choose_serve_token("127.0.0.1") == choose_serve_token("0.0.0.0") == "a-token-that-stays"
    monkeypatch.setenv(SERVE_TOKEN, "short")
    with pytest.raises(InputError, match=SERVE_TOKEN):
        choose_serve_token("0.0.0.0")


LOCAL = {"host": "localhost:10001"}


@pytest.mark.parametrize(
    ("peer", "headers", "target", "own", "welcome"),
    [
        ("127.0.0.1", LOCAL, "/", True, True),
        ("127.0.0.1", {"host": "127.0.0.1:10001", "origin": "http://localhost:8000"}, "/", True, True),
        ("127.0.0.1", {"host": "[::1]:10001"}, "/", True, True),
        ("127.0.0.1", {**LOCAL, "origin": "https://evil.example"}, "/", True, False),
        ("127.0.0.1", {**LOCAL, "origin": "http://localhost.evil.example"}, "/", True, False),
        ("127.0.0.1", {**LOCAL, "origin": "null"}, "/", True, False),
        ("127.0.0.1", {**LOCAL, "origin": ""}, "/", True, False),
        ("127.0.0.1", {"host": "rebound.example:10001"}, "/", True, False),
        ("127.0.0.1", {}, "/", True, False),
        ("192.0.2.7", {"host": "192.0.2.1:10001"}, "/", False, False),
        ("192.0.2.7", {"host": "192.0.2.1", "authorization": "Bearer a-token-of-the-run"}, "/", False, True),
        ("192.0.2.7", {"host": "192.0.2.1"}, "/?token=a-token-of-the-run", False, True),
        ("192.0.2.7", {"host": "192.0.2.1"}, "/?token=a-token-of-the-ruin", False, False),
        (
            "192.0.2.7",
            {"host": "192.0.2.1", "origin": "https://evil.example"},
            "/?token=a-token-of-the-run",
            False,
            False,
        ),
        ("127.0.0.1", LOCAL, "/", False, False),  # another account of this computer
        ("127.0.0.1", LOCAL, "/?token=a-token-of-the-run", False, True),
    ],
)
def test_who_may_connect(peer, headers, target, own, welcome):
    assert (Access("a-token-of-the-run").refuse(peer, headers, target, own=own) == "") is welcome


def test_without_a_token_nobody_comes_from_beyond():
    assert Access("").refuse("192.0.2.7", {"host": "192.0.2.1"}, "/?token=", own=False)
    assert Access("").refuse("127.0.0.1", LOCAL, "/?token=", own=False)
