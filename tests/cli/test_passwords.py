"""A database's password reaches the server only: no process list, no output, no message."""

from __future__ import annotations

import os
import socket
import struct
import subprocess
import sys
import threading
from contextlib import suppress
from pathlib import Path

import pytest
from sqlalchemy import make_url

from haptorb.cli import main
from haptorb.database_address import has_password, mask_password

SECRET = "correct-horse-battery"
_ENCRYPT = (80877103, 80877104)  #: PostgreSQL's codes for "may I speak TLS", "may I speak GSSAPI"


class AskingServer(threading.Thread):
    """Speaks as much of PostgreSQL's protocol 3.0 as asks for a password in clear text, looks at all processes of the
    computer, and says that the password is wrong."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.port = self.listener.getsockname()[1]
        self.passwords, self.lines = list[str](), list[bytes]()

    def run(self) -> None:
        with suppress(OSError):
            while True:
                connection, _ = self.listener.accept()
                with connection, connection.makefile("rb") as said, suppress(struct.error):
                    while struct.unpack("!II", head := said.read(8))[1] in _ENCRYPT:
                        connection.sendall(b"N")
                    said.read(struct.unpack("!I", head[:4])[0] - 8)
                    connection.sendall(b"R" + struct.pack("!II", 8, 3))
                    _, length = struct.unpack("!cI", said.read(5))
                    self.passwords.append(said.read(length - 4).rstrip(b"\0").decode())
                    for process in Path("/proc").glob("[0-9]*/cmdline"):
                        with suppress(OSError):
                            self.lines.append(process.read_bytes())
                    fault = b"SFATAL\0C28P01\0Mpassword authentication failed\0\0"
                    connection.sendall(b"E" + struct.pack("!I", len(fault) + 4) + fault)


@pytest.mark.parametrize(("words", "source"), [(("study", "participants"), "variable"), (("design", "report"), "file")])
def test_a_password_reaches_the_server_alone(words: tuple[str, ...], source: str, tmp_path: Path) -> None:
    server = AskingServer()
    server.start()
    file = tmp_path / "pgpass"
    file.write_text(f"127.0.0.1:{server.port}:name:me:{SECRET}\n")
    file.chmod(0o600)
    given = {"PGPASSWORD": SECRET} if source == "variable" else {"PGPASSFILE": str(file)}
    done = subprocess.run(
        [sys.executable, "-P", "-m", "haptorb", *words, f"postgresql://me@127.0.0.1:{server.port}/name"],
        capture_output=True, text=True, cwd=tmp_path, env={**os.environ, **given}, check=False,
    )  # fmt: skip
    server.listener.close()
    assert server.passwords
    assert set(server.passwords) == {SECRET}
    assert any(str(server.port).encode() in line for line in server.lines)  # the program itself was seen
    assert not [line for line in server.lines if SECRET.encode() in line]
    assert done.returncode == 2
    assert "password authentication failed" in done.stderr
    assert SECRET not in done.stdout + done.stderr


@pytest.mark.parametrize(
    "address", [f"postgresql://me:{SECRET}@HOST/x", f"postgres://HOST/x?user=me&password={SECRET}"]
)
@pytest.mark.parametrize(
    "words",
    [("study", "participants", "ADDRESS"), ("study", "run", "s.toml", "--db=ADDRESS"),
     ("study", "run", "s.toml", "--db", "ADDRESS"), ("study", "merge", "all.db", "one.db", "ADDRESS"),
     ("design", "optimise", "m.toml", "--into", "ADDRESS"), ("design", "show", "ADDRESS")],
)  # fmt: skip
def test_an_address_with_a_password_is_refused(
    address: str, words: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.setblocking(False)
        place = address.replace("HOST", f"127.0.0.1:{server.getsockname()[1]}")
        assert main([word.replace("ADDRESS", place) for word in words]) == 2
        with pytest.raises(BlockingIOError):  # nobody has come
            server.accept()
    said = "".join(capsys.readouterr())
    assert "PGPASSWORD" in said
    assert ".pgpass" in said
    assert SECRET not in said
    assert not list(tmp_path.iterdir())


def test_a_password_is_noticed_where_nothing_for_databases_is_installed(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """As after `pip install haptorb`: SQLAlchemy comes with the extras only."""
    monkeypatch.setitem(sys.modules, "sqlalchemy", None)
    for name in [name for name in sys.modules if name.startswith("sqlalchemy.") or name == "haptorb.sql"]:
        monkeypatch.delitem(sys.modules, name)
    assert main(["run", f"postgresql://me:{SECRET}@host/x"]) == 2
    said = "".join(capsys.readouterr())
    assert "PGPASSWORD" in said
    assert SECRET not in said


#: address, whether it holds a password, and what is shown of it
ADDRESSES = [
    (f"postgresql://me@host/x?password={SECRET}&sslpassword={SECRET}", True,
     "postgresql://me@host/x?password=***&sslpassword=***"),
    (f"postgresql://host/x?%70assword={SECRET}", True, "postgresql://host/x?%70assword=***"),
    (f"postgresql://me:{SECRET}@host:5432/x", True, "postgresql://me:***@host:5432/x"),
    (f"postgresql://:{SECRET}@/x", True, "postgresql://:***@/x"),
    (f"postgresql+psycopg://me:a/{SECRET}?@host/x", True, "postgresql+psycopg://me:***@host/x"),
    ("postgresql://me@host:5432/x?sslmode=require", False, "postgresql://me@host:5432/x?sslmode=require"),
    ("postgresql://host:5432/x", False, "postgresql://host:5432/x"),
    ("postgresql://me@[::1]:5432/x", False, "postgresql://me@[::1]:5432/x"),
    ("study.db", False, "study.db"),
    ("sqlite:////tmp/me:you@home.db", False, "sqlite:////tmp/me:you@home.db"),
]  # fmt: skip


@pytest.mark.parametrize(("address", "secret", "shown"), ADDRESSES)
def test_a_password_is_found_and_masked(address: str, secret: bool, shown: str) -> None:
    assert (has_password(address), mask_password(address)) == (secret, shown)
    url = make_url(address if "://" in address else f"sqlite:///{address}")  # which is what connects
    assert (url.password is not None or bool({"password", "sslpassword"} & set(url.query))) is secret


@pytest.mark.parametrize("address", [f"postgresql://me:a@{SECRET}@host/x", f"my own://me:{SECRET}@host:none/x"])
def test_a_password_is_masked_where_sqlalchemy_finds_none_or_less(address: str) -> None:
    assert has_password(address)
    assert SECRET not in mask_password(address)
