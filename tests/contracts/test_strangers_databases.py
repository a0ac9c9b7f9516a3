"""Foreign, damaged and read-only databases: one message, and no change."""

from __future__ import annotations

import json
import os
import shutil
import socket
import sqlite3
import struct
from contextlib import closing
from pathlib import Path

import pytest

from haptorb.cli import main
from haptorb.errors import InputError, RecordingError
from haptorb_design.problem import Evaluation
from haptorb_design.store import open_results, read_results
from haptorb_study.cli import _find_beside
from haptorb_study.columns import read_study
from haptorb_study.database import database
from haptorb_study.simulated.rehearsal import rehearse
from haptorb_study.study_file import study_of
from oracles.designs.small_design import make_design

READERS = ("participants {} --json", "analyse {} --json", "figures {} --out f", "export {} t.csv")
TEXT = 'name = "one"\n[set_points]\npoints = [{ number = 1, theta_deg = 0 }, { number = 2, theta_deg = 36 }]\n'


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study's database with two simulated people, and a results file of three designs."""
    folder = tmp_path_factory.mktemp("made")
    engine = database(folder / "study.db")
    rehearse(engine, study_of(f"{TEXT}[trials]\nrepetitions = 2\n"), 2, seed=1)
    engine.dispose()
    (folder / "study.toml").write_text(f"{TEXT}[trials]\nrepetitions = 2\n")
    values = {"radius": 30.0, "angle": 55.0, "shell": "thin"}
    with open_results(folder / "results.sqlite", make_design(folder), "sobol", 1) as writer:
        writer.add([Evaluation(n, values, {"cost": 1.0, "reach": 2.0 + n}, {"room": 0.02}) for n in range(3)])
    return folder


@pytest.fixture
def folder(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    shutil.copytree(made, tmp_path / "it")
    monkeypatch.chdir(tmp_path / "it")
    return tmp_path / "it"


def run(line: str) -> int:
    try:
        return main(line.split())
    except SystemExit as end:
        return int(end.code or 0)


def refusal(line: str, capsys: pytest.CaptureFixture[str]) -> str:
    """The one line with which a command refuses."""
    capsys.readouterr()
    assert run(line) == 2, capsys.readouterr()
    said = capsys.readouterr().err.strip()
    assert len(said.splitlines()) == 1, said
    assert len(said) < 600
    return said


def change(path: Path, *statements: str) -> None:
    with closing(sqlite3.connect(path, isolation_level=None)) as found:
        for one in statements:
            found.execute(one)


@pytest.mark.parametrize("command", ["analyse", "figures"])
def test_the_links_beside_a_database_are_not_written_through(
    folder: Path, command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A folder from a stranger may hold what a command writes by default: as links to a file of one's own."""
    place = folder / f"one-{'report' if command == 'analyse' else command}"
    place.symlink_to(tmp_path / "elsewhere", target_is_directory=True)
    (tmp_path / "elsewhere").mkdir()
    assert "is a link" in refusal(f"study {command} study.db", capsys)
    assert list((tmp_path / "elsewhere").iterdir()) == []
    place.unlink()
    place.mkdir()
    force = "" if command == "analyse" else " --force"
    assert run(f"study {command} study.db{force}") == 0
    precious = tmp_path / "precious"
    precious.write_text("mine")
    names = [path.name for path in place.iterdir()]
    assert len(names) >= 3
    for name in names:
        (place / name).unlink()
        (place / name).symlink_to(precious)
    assert run(f"study {command} study.db{force}") == 0
    assert precious.read_text() == "mine"
    assert not any(path.is_symlink() for path in place.iterdir())


PROMPT = {"phase": "main", "condition": "", "other": "", "set_point": 1, "level": 0, "interval": 0}
#: table, column → values that are not there in any database that haptorb wrote
DAMAGE: list[tuple[str, str, list[object]]] = [
    ("trials", "prompt", ["", "{", "[]", "3", "{}", '{"level": "a"}', "[" * 3000, b"\xff\xfe",
                          json.dumps(PROMPT | {"condition": 3}), json.dumps(PROMPT | {"set_point": 1.5})]),
    ("trials", "answer", ["one", b"\0", 1e300, "nan"]),
    ("trials", "seconds", ["soon", b"", 1e300]),
    ("trials", "x", ["there", b"1"]),
    ("trials", "safety", ["{", "3", "null", b"[]", "[[]]"]),
    ("trials", "number", ["first", -1, 2.5]),
    ("trials", "recording", [b"a", "\x1b[31m", ""]),
    ("trials", "answered", [b"a", ""]),
    ("trials", "driver", [b"sim", "\x07"]),
    ("sessions", "plan", ["", "[]", b"{}", 3]),
    ("sessions", "versions", ["", "[]", b"{}"]),
    ("sessions", "simulated", [2, "yes", b"1"]),
    ("sessions", "aborted", ["no", 7]),
    ("sessions", "started", [b"now", "\n"]),
    ("sessions", "ended", [b"now"]),
    ("participants", "code", ["", b"P1", "\x1b]0;x\x07", "a" * 300]),
    ("participants", "ordinal", ["one", -1, 1.5]),
    ("studies", "text", ["", "name = ", b"name = 'one'", "name = 'one'\nworld = 3", "[" * 5000, "x" * 300_000]),
    ("studies", "name", [b"one", ""]),
    ("copies", "kind", ["", "other", b"export"]),
    ("copies", "place", ["", "\x1b", b"a", "x" * 5000]),
    ("copies", "settings", ["", "[]", b"{}", "[" * 3000, '{"codes": 3}', '{"codes": {"P01": 3}}', '{"data": []}']),
    ("withdrawn", "code", ["", b"P01", "a" * 300]),
    ("withdrawn", "text", [b"gone"]),
]  # fmt: skip


@pytest.mark.parametrize(("table", "column", "values"), DAMAGE, ids=[f"{t}.{c}" for t, c, _ in DAMAGE])
def test_a_damaged_field_is_one_message(
    folder: Path, table: str, column: str, values: list[object], capsys: pytest.CaptureFixture[str]
) -> None:
    good = (folder / "study.db").read_bytes()
    for value in values:
        (folder / "study.db").write_bytes(good)
        with closing(sqlite3.connect(folder / "study.db", isolation_level=None)) as found:
            found.execute(
                "INSERT OR IGNORE INTO copies (kind, place, study, settings, at) VALUES ('export', '/a', '', '{}', 't')"
            )
            found.execute(
                "INSERT OR IGNORE INTO withdrawn (study, code, ordinal, at, text) "
                "SELECT digest, 'P99', 9, 't', '' FROM studies"
            )
            found.execute(f"UPDATE {table} SET {column} = ? WHERE rowid = (SELECT min(rowid) FROM {table})", (value,))
        before = (folder / "study.db").read_bytes()
        with pytest.raises((RecordingError, InputError), match=r"study\.db is damaged|in the database") as told:
            read_study(database("study.db", make=False))
        assert len(str(told.value)) < 600
        assert str(told.value).isprintable()
        assert (folder / "study.db").read_bytes() == before
    assert "study.db is damaged" in refusal("study participants study.db", capsys) or table == "studies"


def test_every_command_says_that_a_database_is_damaged(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    change(folder / "study.db", "UPDATE trials SET prompt = '{' WHERE id = 1")
    for reader in (*READERS, "simulate study.toml --participants 1 --db {}"):
        said = refusal(f"study {reader.format('study.db')}", capsys)
        assert "'prompt' in table 'trials' (id 1) must be what was asked (JSON); got '{'" in said
    assert not (folder / "t.csv").exists()


@pytest.mark.parametrize(
    ("statements", "told"),
    [
        (("ALTER TABLE trials RENAME TO old", "CREATE VIEW trials AS SELECT * FROM old"), "view, 'trials'"),
        (("CREATE TRIGGER t AFTER INSERT ON events BEGIN DELETE FROM trials; END",), "trigger, 't'"),
        (("CREATE VIRTUAL TABLE v USING fts5(a)",), "computed table, 'v'"),
        (("ALTER TABLE events ADD COLUMN bomb AS (hex(zeroblob(900000000)))",), "computed table, 'events'"),
        (("DROP TABLE replies",), "cannot be read: no such table: replies"),
        (("ALTER TABLE trials RENAME COLUMN prompt TO other",), "no such column"),
        (("UPDATE haptorb_schema SET version = 99",), "has schema 99"),
        (("DELETE FROM haptorb_schema",), "study.db"),
    ],
)
def test_a_schema_that_computes_is_not_opened(
    folder: Path, statements: tuple[str, ...], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    change(folder / "study.db", *statements)
    assert told in refusal("study analyse study.db --json", capsys)


def hot_journal(database: Path, names: Path) -> bytes:
    """A rollback journal that says another journal, `names`, is to be removed when it has been played back."""
    name = str(names).encode()
    size = struct.unpack(">H", database.read_bytes()[16:18])[0]
    pages = len(database.read_bytes()) // size
    head = bytes.fromhex("d9d505f920a163d7") + struct.pack(">IIIII", 0, 0, pages, 512, size)
    tail = struct.pack(">I", 0x40000000 // size + 1) + name + struct.pack(">II", len(name), sum(name)) + head[:8]
    return head.ljust(512, b"\0") + tail


def test_files_beside_a_database_do_nothing(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    canary = tmp_path / "canary"
    canary.write_text("what is not its business")
    for end, told in (("-wal", "not a regular file"), ("-shm", "not a regular file"), ("-journal", "rollback journal")):
        beside = folder / f"study.db{end}"
        beside.symlink_to(canary)
        for line in ("study analyse study.db --json", "study simulate study.toml --db study.db"):
            assert told in refusal(line, capsys)
        beside.unlink()
    (folder / "study.db-journal").write_bytes(hot_journal(folder / "study.db", canary))
    assert "rollback journal" in refusal("study analyse study.db --json", capsys)
    assert canary.read_text() == "what is not its business"
    (folder / "study.db-journal").unlink()
    os.mkfifo(folder / "pipe.db")
    assert "not a regular file" in refusal("study analyse pipe.db --json", capsys)
    assert "not a regular file" in refusal("study analyse /dev/zero --json", capsys)
    assert "not a regular file" in refusal("design report /dev/zero -o r.html", capsys)


def test_files_beside_what_a_linked_database_leads_to_do_nothing(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """SQLite follows a link to a database, and looks beside the file itself."""
    canary = tmp_path / "canary"
    canary.write_text("what is not its business")
    (folder / "in").mkdir()
    (folder / "study.db").rename(folder / "in" / "it.db")
    (folder / "study.db").symlink_to(Path("in", "it.db"))
    (folder / "in" / "it.db-journal").write_bytes(hot_journal(folder / "in" / "it.db", canary))
    assert "rollback journal" in refusal("study analyse study.db --json", capsys)
    assert canary.read_text() == "what is not its business"


def trap(lock: Path, way: str, canary: Path) -> None:
    """A lock file, with a journal that says that `canary` is to be removed."""
    canary.write_text("what is not its business")
    if way == "link":
        lock.symlink_to(canary)
        return
    change(lock, "CREATE TABLE t (a)")
    lock.with_name(f"{lock.name}-journal").write_bytes(hot_journal(lock, canary))
    if way == "empty":
        lock.write_bytes(b"")
        lock.with_name(f"{lock.name}-wal").symlink_to(canary)


@pytest.mark.parametrize(
    ("line", "way"),
    [("withdraw study.db SIM01 --yes", "journal"), ("withdraw study.db SIM01 --yes", "empty"),
     ("withdraw study.db SIM01 --yes", "link"), ("merge study.db other.db --into both.db", "journal"),
     ("simulate study.toml --participants 2 --db study.db", "journal")],
)  # fmt: skip
def test_a_lock_file_of_a_stranger_is_not_obeyed(
    folder: Path, tmp_path: Path, line: str, way: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """SQLite makes the lock: a lock file that is a database could have another file deleted."""
    trap(folder / "study.db.session-1.lock", way, tmp_path / "canary")
    change(folder / "study.db", "UPDATE sessions SET ended = NULL")
    if "other.db" in line:
        shutil.copy(folder / "study.db", folder / "other.db")
        change(folder / "other.db", "UPDATE participants SET code = 'SIM1' || id")
    if way == "empty":  # as of a killed program: what lies beside it is removed
        assert run(f"study {line}") == 0
        assert list(folder.glob("*.lock*")) == []
    else:
        assert "nothing can be locked" in refusal(f"study {line}", capsys)
    assert (tmp_path / "canary").read_text() == "what is not its business"


def test_a_lock_file_of_a_strangers_results_is_not_obeyed(folder: Path, tmp_path: Path) -> None:
    trap(folder / "results.sqlite.run-1.lock", "journal", tmp_path / "canary")
    with (
        pytest.raises(RecordingError, match="nothing can be locked"),
        open_results(folder / "results.sqlite", make_design(folder), "sobol", 1),
    ):
        pass
    assert (tmp_path / "canary").read_text() == "what is not its business"


def test_a_merge_looks_beside_its_sources_before_sqlite_does(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A pipe as rollback journal would be waited for without an end: here it is a file."""
    shutil.copy(folder / "study.db", folder / "other.db")
    (folder / "other.db-journal").touch()
    assert "rollback journal" in refusal("study merge study.db other.db --into both.db", capsys)
    (folder / "other.db-journal").unlink()
    (folder / "other.db-wal").symlink_to(folder / "study.toml")
    assert "not a regular file" in refusal("study merge study.db other.db --into both.db", capsys)
    assert "not the database of a study" in refusal("study merge study.db results.sqlite --into both.db", capsys)


def test_each_connection_looks_beside_the_file(folder: Path) -> None:
    """Also one that is made later, and one by an address."""
    engine = database("sqlite+pysqlite:///study.db?timeout=3", make=False)
    engine.dispose()
    (folder / "study.db-journal").touch()
    with pytest.raises(RecordingError, match="rollback journal"):
        engine.connect()
    with pytest.raises(RecordingError, match="rollback journal"):
        database("sqlite+pysqlite:///study.db?timeout=3", make=False)


def test_a_question_mark_belongs_to_the_name_of_a_file(folder: Path) -> None:
    """Or the file that is checked would not be the one that is opened."""
    (folder / "study.db").rename(folder / "study.db?x=1")
    assert read_study(database("study.db?x=1", make=False)).name == "one"
    assert not (folder / "study.db").exists()


def test_a_backup_is_written_to_a_new_file(folder: Path, tmp_path: Path) -> None:
    """Not to one that lies there with a journal."""
    canary, part = tmp_path / "canary", folder / ".kept.db.part"
    canary.write_text("what is not its business")
    change(part, "CREATE TABLE t (a)")
    part.with_name(f"{part.name}-journal").write_bytes(hot_journal(part, canary))
    assert run("study backup study.db kept.db") == 0
    assert canary.read_text() == "what is not its business"


def test_a_database_that_is_locked_or_read_only_says_so(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("haptorb.sql.BUSY_TIMEOUT_MS", 50)
    with closing(sqlite3.connect(folder / "study.db", isolation_level=None)) as other:
        other.execute("PRAGMA locking_mode = EXCLUSIVE")
        other.execute("BEGIN EXCLUSIVE")
        for line in ("study analyse study.db --json", "study simulate study.toml --participants 1 --db study.db"):
            assert "database is locked" in refusal(line, capsys)
    if os.getuid() != 0:  # root writes everywhere
        (folder / "study.db").chmod(0o400)
        folder.chmod(0o500)
        try:
            assert "study.db" in refusal("study simulate study.toml --participants 1 --db study.db", capsys)
        finally:
            folder.chmod(0o700)


@pytest.mark.parametrize(
    "name",
    ["{outside}/one-session-1-trial-1.mcap", "../outside/one-session-1-trial-1.mcap", "{outside}/thesis.txt",
     "thesis.txt", "notes.mcap", "../it/thesis.txt"],
)  # fmt: skip
def test_a_withdrawal_and_a_merge_touch_recordings_of_haptorb_beside_the_database_only(
    folder: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    outside = folder.parent / "outside"
    outside.mkdir()
    kept = [
        outside / "one-session-1-trial-1.mcap",
        outside / "thesis.txt",
        folder / "thesis.txt",
        folder / "notes.mcap",
    ]
    for path in kept:
        path.write_text("years of work")
    with closing(sqlite3.connect(folder / "study.db", isolation_level=None)) as found:
        found.execute("UPDATE trials SET recording = ?", (f"{name.format(outside=outside)}#t=0,1",))
        (code,) = found.execute("SELECT code FROM participants WHERE ordinal = 0").fetchone()
    engine = database("other.db")
    rehearse(engine, read_study(database("study.db", make=False)), 3, seed=2, first=5)
    engine.dispose()
    files = set(folder.rglob("*.mcap"))
    assert run("study merge study.db other.db --into both.db") == 0
    assert set(folder.rglob("*.mcap")) == files
    assert run(f"study withdraw study.db {code} --yes") == 0
    assert "years of work" not in capsys.readouterr().out
    assert [path.read_text() for path in kept] == ["years of work"] * 4


@pytest.mark.parametrize("name", ["*", "../outside/one", "othe[r]"])
def test_the_name_of_a_study_matches_no_other_recordings(folder: Path, name: str) -> None:
    outside = folder.parent / "outside"
    outside.mkdir()
    kept = [outside / "one-session-1-trial-1.mcap", folder / "other-session-1-trial-1.mcap"]
    for path in kept:
        path.write_text("others'")
    with closing(sqlite3.connect(folder / "study.db", isolation_level=None)) as found:
        found.execute("PRAGMA foreign_keys = OFF")
        found.execute("INSERT INTO studies (digest, name, text) SELECT 'x', ?, text FROM studies LIMIT 1", (name,))
        found.execute("UPDATE trials SET recording = NULL")
        (code,) = found.execute("SELECT code FROM participants WHERE ordinal = 0").fetchone()
    assert run(f"study withdraw study.db {code} --yes --study one") == 0
    assert [path.read_text() for path in kept] == ["others'"] * 2


@pytest.mark.parametrize("kind", ["backup", "merged", "source"])
@pytest.mark.parametrize("again", [False, True])
def test_a_withdrawal_removes_nobody_from_a_database_that_a_strangers_names(
    folder: Path, kind: str, again: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    """It names the code there, too: of somebody else."""
    mine = folder / "mine.db"
    shutil.copy(folder / "study.db", mine)
    with closing(sqlite3.connect(mine)) as found:
        one, other = (row[0] for row in found.execute("SELECT code FROM participants ORDER BY id"))
        people = found.execute("SELECT count(*) FROM trials").fetchone()
    codes = json.dumps({} if kind == "backup" else {"codes": {one: other}})
    change(folder / "study.db", "UPDATE sessions SET started = '2026-01-01T00:00:00.000+00:00'")
    if again:
        assert run(f"study withdraw study.db {one} --yes") == 0
    change(
        folder / "study.db",
        f"INSERT INTO copies (kind, place, study, settings, at) VALUES ('{kind}', '{mine}', '', '{codes}', 't')",
    )
    capsys.readouterr()
    assert run(f"study withdraw study.db {one} --yes") == 0
    assert f"withdraw {one if kind == 'backup' else other} there" in capsys.readouterr().err
    with closing(sqlite3.connect(mine)) as found:
        assert found.execute("SELECT count(*) FROM participants").fetchone() == (2,)
        assert found.execute("SELECT count(*) FROM trials").fetchone() == people


def test_a_withdrawal_connects_to_no_server_that_a_file_names(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        place = f"postgresql://127.0.0.1:{server.getsockname()[1]}/x?connect_timeout=2"
        change(
            folder / "study.db",
            f"INSERT INTO copies (kind, place, study, settings, at) VALUES ('merged', '{place}', '', '{{}}', 't')",
        )
        with closing(sqlite3.connect(folder / "study.db")) as found:
            (code,) = found.execute("SELECT code FROM participants").fetchone()
        assert run(f"study withdraw study.db {code} --yes") == 0
        assert f"withdraw {code} there" in capsys.readouterr().err
        server.settimeout(0.0)
        with pytest.raises(BlockingIOError):
            server.accept()


def name_export(place: Path) -> str:
    """Have the database name this export; the code of a person in it."""
    row = (str(place), "one", "{}", "t")
    with closing(sqlite3.connect("study.db", isolation_level=None)) as found:
        found.execute(
            "INSERT OR IGNORE INTO copies (kind, place, study, settings, at) VALUES ('export', ?, ?, ?, ?)", row
        )
        (code,) = found.execute("SELECT code FROM participants WHERE ordinal = 0").fetchone()
    return str(code)


@pytest.mark.parametrize(
    "way", ["own table", "own columns", "own file beside", "other version", "linked", "outside", "outside folder"]
)
def test_a_withdrawal_replaces_exports_of_its_own_study_only(
    folder: Path, tmp_path: Path, way: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Any table with a column of trials is not one: somebody's own work, in the folder of a stranger's database."""
    place = tmp_path / "outside" / "rt.csv" if way.startswith("outside") else folder / "rt.csv"
    place = place.with_suffix("") if way == "outside folder" else place
    place.parent.mkdir(exist_ok=True)
    if way == "own table":
        place.write_text("subject,trial,rt\nA,1,0.35\n")
        for name in ("rt.json", "rt-questions.csv", "read_rt.py"):
            (folder / name).write_text("{}")
    else:
        assert run(f"study export study.db {place}") == 0
    if way == "own file beside":
        (folder / "rt-questions.csv").write_text("my own")
    elif way == "own columns":
        place.write_text("subject,trial,rt\nA,1,0.35\n")
    elif way == "other version":
        about = folder / "rt.json"
        about.write_text(about.read_text().replace('"digest ', '"digest 0'))
    elif way == "linked":
        (folder / "kept.json").write_text((folder / "rt.json").read_text())
        (folder / "rt.json").unlink()
        (folder / "rt.json").symlink_to("kept.json")
    code = name_export(place)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file() and "study.db" not in path.name}
    capsys.readouterr()
    assert run(f"study withdraw study.db {code} --yes") == 0
    told = capsys.readouterr()
    assert "not touched" in told.err
    assert "0 exports made again" in told.out
    now = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file() and "study.db" not in path.name}
    assert now == before
    if way == "outside":
        assert "--exports-in" in told.err
        assert run(f"study withdraw study.db {code} --yes --exports-in {place.parent}") == 0
        assert "1 exports made again" in capsys.readouterr().out
        assert code not in place.read_text()


def test_an_export_is_written_over_no_file_of_somebody_else(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What an earlier export left beside a table is removed; other files that have such a name are not."""
    assert run("study export study.db t.csv") == 0
    (folder / "t-questions.csv").write_text("participant,question,text,reply\nP99,a,b,c\n")
    assert run("study export study.db t.csv --force") == 0
    assert not (folder / "t-questions.csv").exists()
    (folder / "t-questions.csv").write_text("my own")
    assert "was not written by haptorb" in refusal("study export study.db t.csv --force", capsys)
    assert (folder / "t-questions.csv").read_text() == "my own"


@pytest.mark.parametrize("end", ["csv", "parquet"])
def test_an_export_that_a_database_names_is_not_waited_for(folder: Path, end: str) -> None:
    """A pipe, or a file without an end, in place of the export that a withdrawal makes again."""
    os.mkfifo(folder / f"pipe.{end}")
    (folder / f"zero.{end}").symlink_to("/dev/zero")
    with closing(sqlite3.connect(folder / "study.db", isolation_level=None)) as found:
        for name in ("pipe", "zero"):
            found.execute(
                "INSERT INTO copies (kind, place, study, settings, at) VALUES ('export', ?, '', '{}', 't')",
                (str(folder / f"{name}.{end}"),),
            )
        (code,) = found.execute("SELECT code FROM participants WHERE ordinal = 0").fetchone()
    assert run(f"study withdraw study.db {code} --yes") == 0
    assert (folder / f"pipe.{end}").is_fifo()
    assert (folder / f"zero.{end}").is_symlink()


@pytest.mark.parametrize("way", ["elsewhere", "linked", "beside"])
def test_a_database_names_a_device_of_the_catalogue_or_beside_it_only(
    folder: Path, tmp_path: Path, way: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """It would have any file opened otherwise."""
    mine = tmp_path / "mine.toml"
    mine.write_text('based_on = "omni"\nname = "mine"\n')
    study = study_of(f"device = '{mine}'\n{TEXT}[trials]\nrepetitions = 2\n")
    text, digest = study.text, study.digest
    with closing(sqlite3.connect(folder / "study.db", isolation_level=None)) as found:
        found.execute("PRAGMA foreign_keys = OFF")
        found.execute("UPDATE studies SET text = ?, digest = ?", (text, digest))
        found.execute("UPDATE participants SET study = ?", (digest,))
    if way == "linked":
        (folder / "mine.toml").symlink_to(mine)
    elif way == "beside":
        shutil.move(mine, folder / "mine.toml")
        assert run("study export study.db t.csv") == 0
        assert study_of(text, stored=True).load_device().name == "mine"
        return
    for line in ("analyse study.db --json", "figures study.db --out f", "export study.db t.csv"):
        assert f"copy it to {folder / 'mine.toml'}" in refusal(f"study {line}", capsys)


def test_the_recordings_of_a_database_lie_beside_it() -> None:
    assert _find_beside("/a/study.db", "/etc/passwd#t=1,2") == "/a/passwd#t=1,2"
    assert _find_beside("study.db", "../../x.mcap") == str(Path.cwd() / "x.mcap")
    assert _find_beside("study.db", "--help") == str(Path.cwd() / "--help")  # no option of `haptorb view`


@pytest.mark.parametrize(
    ("key", "value"),
    [("name", "../../x"), ("name", "a/b"), ("name", "\x1b"), ("record", {}), ("record", []), ("goals", []),
     ("goals", [3]), ("parameters", [{"name": "x"}]), ("parameters", []), ("tables", 3), ("title", 3),
     ("bounds", "abc"), ("device", 3)],
)  # fmt: skip
def test_results_of_a_stranger_name_no_file(folder: Path, key: str, value: object) -> None:
    with closing(sqlite3.connect(folder / "results.sqlite", isolation_level=None)) as found:
        if key == "name":
            found.execute("UPDATE designs SET name = ?", (value,))
        else:
            record = json.loads(found.execute("SELECT record FROM designs").fetchone()[0])
            text = json.dumps(value if key == "record" else record | {key: value})
            found.execute("UPDATE designs SET record = ?", (text,))
    with pytest.raises(RecordingError, match=r"results\.sqlite cannot be read"):
        read_results("results.sqlite")


@pytest.mark.parametrize(
    "change_of",
    ['"values" = \'{}\'', '"values" = \'[]\'', '"values" = json_set("values", \'$.radius\', \'x\')',
     "objectives = '{}'", "objectives = '{\"cost\": NaN, \"reach\": 1}'", "objectives = ''", "seconds = 'x'",
     "reason = x'ff'", "number = -1"],
)  # fmt: skip
def test_damaged_results_are_one_message(folder: Path, change_of: str) -> None:
    change(folder / "results.sqlite", f"UPDATE evaluations SET {change_of} WHERE number = 1")
    with pytest.raises(RecordingError, match=r"results.sqlite cannot be read"):
        read_results(folder / "results.sqlite")


@pytest.mark.parametrize("place", [".", "/", ".."])
def test_a_folder_is_no_database(place: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["study", "participants", place]) == 2
    assert len("".join(capsys.readouterr()).splitlines()) == 1
