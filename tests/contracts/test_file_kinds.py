"""File kinds: every command names the kind of a wrong file in one message, and changes nothing."""

from __future__ import annotations

import hashlib
import json
from importlib.resources import files
from pathlib import Path

import pytest

from fuzz.good_files import NAMES, fill
from haptorb.cli import main
from haptorb.file_kind import FileKind, find_kind
from haptorb_study.database import database
from oracles.repetitions import repetitions

K = FileKind
#: command, with FILE where a file is named → the kinds that it reads
COMMANDS: dict[str, tuple[FileKind, ...]] = {
    "info FILE": (K.RECORDING,),
    "export FILE -o new.csv": (K.RECORDING,),
    "replay FILE": (K.RECORDING,),
    "view FILE --duration 0.01": (K.RECORDING,),
    "run omni --headless --duration 0.1 --tracker replay:FILE": (K.RECORDING,),
    "run FILE --headless --duration 0.1": (K.DEVICE,),
    "inspect FILE": (K.DEVICE,),
    "show FILE": (K.DEVICE,),
    "check FILE": (K.DEVICE,),
    "calibrate FILE": (K.DEVICE,),
    "frame FILE --rehearse": (K.DEVICE,),
    "train FILE": (K.DEVICE,),
    "run omni --headless --duration 0.1 --calibration FILE": (K.CALIBRATION,),
    "run omni --headless --duration 0.1 --tracker osc:9000 --frame FILE": (K.FRAME,),
    "run omni --headless --duration 0.1 --hand FILE": (K.HAND, K.TABLE, K.RECORDING),
    "run omni --headless --duration 0.1 --world FILE": (K.WORLD,),
    "run omni --headless --duration 0.1 --scene FILE": (K.SCENE,),
    "check omni --world FILE": (K.WORLD,),
    "check omni --scene FILE": (K.SCENE,),
    "calibrate omni --out new.json --thermal FILE": (K.TABLE, K.RECORDING),
    "feel FILE --headless": (K.FELT_DESIGNS,),
    "study check FILE": (K.STUDY,),
    "study run FILE": (K.STUDY,),
    "study simulate FILE --db new.db": (K.STUDY,),
    "study power FILE": (K.STUDY,),
    "study participants FILE": (K.STUDY_DATABASE,),
    "study analyse FILE": (K.STUDY_DATABASE,),
    "study figures FILE": (K.STUDY_DATABASE,),
    "study export FILE new.csv": (K.STUDY_DATABASE,),
    "study analyse STUDY_DB --registration FILE": (K.REGISTRATION,),
    "study simulate STUDY --db FILE": (K.STUDY_DATABASE,),
    "design sweep FILE": (K.DESIGN,),
    "design optimise FILE": (K.DESIGN,),
    "design sweep DESIGN --into FILE --count 1": (K.RESULTS,),
    "design report FILE -o new.html": (K.RESULTS,),
    "design show FILE --duration 0.01": (K.RESULTS,),
}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("kinds")
    fill(folder)
    return folder


def test_each_kind_is_recognised(made: Path) -> None:
    assert set(NAMES) == set(FileKind) - {FileKind.EMPTY_DATABASE}
    assert {kind: find_kind(made / name) for kind, name in NAMES.items()} == {kind: kind for kind in NAMES}
    assert find_kind("/dev/zero") is None
    assert find_kind(made / "nothing") is None
    for device in (files("haptorb.devices") / "catalogue").iterdir():
        assert find_kind(str(device)) is FileKind.DEVICE, device
    for study in (files("haptorb_study") / "templates").iterdir():
        assert not study.name.endswith(".toml") or find_kind(str(study)) is FileKind.STUDY, study


def _state(folder: Path) -> dict[str, str]:
    return {str(path): hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.rglob("*") if path.is_file()}


def _run(words: list[str]) -> int:
    try:
        return main(words)
    except SystemExit as end:
        return int(end.code or 0)


@pytest.mark.parametrize("command", COMMANDS)
def test_a_file_of_another_kind_is_called_by_its_name(
    made: Path, command: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(made)
    before, wrong = _state(made), []
    every = repetitions(4, 1)  # each kind meets a quarter of the commands, all of them at night
    for number, (kind, name) in enumerate(NAMES.items(), start=list(COMMANDS).index(command)):
        if kind in COMMANDS[command] or number % every:
            continue
        swap = {"FILE": name, "replay:FILE": f"replay:{name}", "STUDY_DB": NAMES[K.STUDY_DATABASE],
                "STUDY": NAMES[K.STUDY], "DESIGN": NAMES[K.DESIGN]}  # fmt: skip
        code = _run([swap.get(word, word) for word in command.split()])
        said = capsys.readouterr().err.strip()
        if code != 2 or kind.title not in said or len(said.splitlines()) != 1 or len(said) > 400:
            wrong.append((name, code, said[-300:]))
    assert wrong == [], "\n".join(map(str, wrong))
    assert _state(made) == before


def test_a_database_that_a_program_has_open_is_read(tmp_path: Path) -> None:
    """Its tables are in the write-ahead log still, where nothing can see them without a lock."""
    engine = database(tmp_path / "study.db")
    with engine.connect():
        assert find_kind(tmp_path / "study.db") in (FileKind.EMPTY_DATABASE, FileKind.STUDY_DATABASE)
        database(tmp_path / "study.db", make=False).dispose()
    engine.dispose()


def test_what_is_damaged_is_not_called_something_else(tmp_path: Path) -> None:
    for text in ("", "\0\0\0", "name = ", '{"format": 3}', "[[[[", json.dumps({"kind": ["haptorb networks"]})):
        (tmp_path / "it").write_text(text)
        assert find_kind(tmp_path / "it") is None, text


STUDY = 'name = "mine"\ninstructions = "café"\n[trials]\npause_seconds = 5\n'
DESIGNS = 'title = "door"\nworld = "snap_fit"\n[design.easy]\ntitle = "café"\nretention = "45 deg"\n'
OMNI_BASED = 'based_on = "omni"\nname = "mine"\ntitle = "café"\n'
TEXTS = [
    ("inspect mine.toml --json", "mine.toml", OMNI_BASED),
    ("inspect MINE.TOML --json", "MINE.TOML", OMNI_BASED),
    ("study check mine.toml --json", "mine.toml", STUDY),
]


@pytest.mark.parametrize(("words", "name", "text"), TEXTS)
def test_a_byte_order_mark_is_no_part_of_a_text(
    words: str, name: str, text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path(name).write_bytes(text.replace("\n", "\r\n").encode("utf-8-sig"))
    try:
        code = main(words.split())
    except SystemExit as end:
        code = int(end.code or 0)
    assert code == 0


@pytest.mark.parametrize(("encoding", "said"), [("utf-16", "UTF-16"), ("utf-16-le", "UTF-16"), ("latin-1", "0xe9")])
@pytest.mark.parametrize(
    ("words", "name", "text"),
    [*TEXTS, ("feel mine.toml", "mine.toml", DESIGNS),
     ("design sweep mine.toml", "mine.toml", '# café\nbase = "omni"\n'),
     ("run omni --headless --world own.py:Own", "own.py", "# café\n"),
     ("run omni --headless --scene mine.XML", "mine.XML", "<mujoco><!-- café --></mujoco>\n")],
)  # fmt: skip
def test_a_text_of_another_encoding_is_called_that(
    words: str, name: str, text: str, encoding: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    Path(name).write_bytes(text.encode(encoding))
    assert main(words.split()) == 2
    told = capsys.readouterr().err
    assert said in told
    assert "save it as UTF-8" in " ".join(told.split())
