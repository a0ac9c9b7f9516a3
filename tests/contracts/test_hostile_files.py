"""Damaged or malicious files: every reader returns or explains, quickly and with little memory."""

from __future__ import annotations

import importlib.util
import io
import json
import os
import random
import struct
import sys
import zlib
from importlib.resources import files
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from fuzz.good_files import NAMES
from fuzz.hostile_commands import COMMANDS, FURTHER, GOOD, craft_files, make_ground, try_files
from haptorb import worlds
from haptorb.devices.loader import load, parse
from haptorb.devices.quantity import si
from haptorb.errors import CalibrationError, DeviceError, InputError, RecordingError, UnknownName
from haptorb.estimation.calibration_file import Calibration, write_calibration
from haptorb.file_kind import FileKind
from haptorb.json_file import numbers, parse_document
from haptorb.recording import destination
from haptorb.recording.mcap import Recorder
from haptorb.recording.recording import Recording
from haptorb.recording.row import RowLayout
from haptorb.runtime.world_requests import change_world, parse_request, request
from haptorb_study.columns import COLUMNS
from haptorb_study.export_table import write_csv
from haptorb_study.study_file import study_of
from oracles.repetitions import repetitions

ROOT = Path(__file__).resolve().parents[2]
OMNI = (files("haptorb.devices") / "catalogue" / "omni.toml").read_text(encoding="utf-8")

KINDS = ("device", "motor", "variant", "design", "study", "calibration", "frame", "parameters", "recording", "network",
         "progress", "ratings", "thermal", "loads", "hand", "hand table")  # fmt: skip
#: of those that take long to read: what is computed of them is the reader's check
FEWER = {"device": 60, "motor": 2, "variant": 2, "design": 60, "study": 60, "recording": 60}


@pytest.fixture(scope="module")
def hostile() -> ModuleType:
    """tests/fuzz/hostile_files.py."""
    spec = importlib.util.spec_from_file_location("hostile_files", ROOT / "tests" / "fuzz" / "hostile_files.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def find_faults(hostile: ModuleType, kind: str, mutants: int, folder: Path) -> Any:
    known = {one.name: one for one in hostile.kinds(folder)}
    assert set(known) == set(KINDS)
    told = hostile.try_mutants(known[kind], mutants, 1, folder)
    assert told.refused > 0  # they were hostile
    return told


@pytest.mark.parametrize("kind", KINDS)
def test_a_few_hundred_of_each(hostile: ModuleType, tmp_path: Path, kind: str) -> None:
    assert find_faults(hostile, kind, FEWER.get(kind, 200), tmp_path).wrong == []


@pytest.fixture(scope="module")
def ground(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Good files and canaries; the files are written anew for each try."""
    return make_ground(tmp_path_factory.mktemp("ground") / "ground")


def test_crafted_files_do_nothing_in_the_commands(ground: tuple[Path, Path]) -> None:
    """A fortieth of them; `python tests/fuzz/hostile_files.py --only crafted` tries all."""
    inside, outside = ground
    found = try_files(list(craft_files(inside, outside))[::40], inside, outside)
    assert found.wrong == []
    assert found.refused > 5


def test_every_command_reads_a_good_file_and_refuses_mutants_in_words(
    hostile: ModuleType, ground: tuple[Path, Path]
) -> None:
    """One of each kind; `python tests/fuzz/hostile_files.py --mutants 0` tries more."""
    inside, outside = ground
    chance, tasks, each = random.Random(4), [], repetitions(1, 4)
    for name, commands in ({NAMES[kind]: commands for kind, commands in COMMANDS.items()} | FURTHER).items():
        good = (inside / name).read_bytes()
        text = Path(name).suffix not in (".mcap", ".sqlite", ".db", ".network", ".png")
        for command in commands:
            tasks.append((GOOD, command, name, good))
            tasks += [(f"{name} {n}", command, name, hostile.mutant(good, chance, text=text)) for n in range(each)]
    found = try_files(tasks, inside, outside)
    assert found.wrong == []
    assert found.refused > found.files // 4


def test_a_database_with_any_page_damaged_is_read_or_refused(ground: tuple[Path, Path]) -> None:
    """SQLite finds it late, and says it in words that may not be UTF-8, or as a lack of memory."""
    inside, outside = ground
    tasks = []
    for kind in (FileKind.STUDY_DATABASE, FileKind.RESULTS):
        good = (inside / NAMES[kind]).read_bytes()
        page = int.from_bytes(good[16:18], "big")
        places = range(page, len(good), page * repetitions(12, 1))  # every twelfth page; every page at night
        damaged = [good.replace(b"CREATE TABLE ", b"CREATE TABLE \xff", 1), good.replace(b"INTEGER", b"\xff\xfeTEGER")]
        damaged += [good[:at] + b"\xff" * 64 + good[at + 64 :] for at in places]
        damaged += [good[:at] + bytes(page) + good[at + page :] for at in places]
        command = COMMANDS[kind][0]
        tasks += [(f"{kind.name} {n}", command, NAMES[kind], one) for n, one in enumerate(damaged)]
    found = try_files(tasks, inside, outside)
    assert found.wrong == []
    assert found.refused > 10


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("kind", KINDS)
def test_ten_thousand_of_each(hostile: ModuleType, tmp_path: Path, kind: str) -> None:
    told = find_faults(hostile, kind, 1000 if kind in ("motor", "variant") else 10_000, tmp_path)
    print(
        f"{kind}: {told.read} read, {told.refused} refused, slowest {told.slowest:.2f} s, {told.memory / 1024:.0f} MB"
    )
    assert told.wrong == []


@pytest.mark.parametrize(
    "value",
    ["1 (m)", "1 m/0", "1 (m", "1 " + "(" * 500 + "m", "1 m^99", "1 yottaparsec^9", "1e999 m", "9" * 400 + " m",
     "1 m\u0000", "1 m\u001b[31m", "1 " + "x" * 300, "1 m m m m m m m m m", "inf m", "1e-300 m", "1 m//s", "1 m*",
     "1 2 m", "45 m**9**9**9"],
)  # fmt: skip
def test_a_unit_is_read_and_not_evaluated(value: str) -> None:
    with pytest.raises(ValueError, match="length") as told:
        si(value, "m", "a length")
    assert len(str(told.value)) < 200
    assert str(told.value).isprintable()
    quoted = json.dumps(value)
    with pytest.raises(DeviceError) as refused:
        parse(OMNI.replace('radius = "30 mm"', f"radius = {quoted}", 1), "x")
    assert len(str(refused.value).splitlines()) == 1
    assert str(refused.value).startswith("device 'x': dome.radius must be a")


@pytest.mark.parametrize(
    ("value", "unit", "number"),
    [("5 %", "", 0.05), ("2.5 °C", "K", 275.65), ("3 µm", "m", 3e-6), ("3 μm", "m", 3e-6), ("180 °", "rad", np.pi),
     ("2 kg·m²", "kg*m**2", 2.0), ("2 kg m^2", "kg*m**2", 2.0), ("3.93e-3 / K", "1/K", 3.93e-3), ("4 1/K", "1/K", 4.0),
     ("1 m⁻¹", "1/m", 1.0), ("1 N per mm", "N/m", 1e3), ("8 A/ms", "A/s", 8e3), ("0.1 Δ°C", "delta_degC", 0.1),
     ("2 Ω", "ohm", 2.0), ("12.5 m/s/s", "m/s**2", 12.5), ("inf", "", np.inf), (".5 inch", "m", 0.0127)],
)  # fmt: skip
def test_what_people_write_is_read(value: str, unit: str, number: float) -> None:
    assert si(value, unit, "a value") == pytest.approx(number, rel=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ('name = "omni"', f'name = "{"x" * 300}"', "name"),
        ('based_on = "', 'x = "', "x is not a known key"),
        ("duty_bits = 12", "duty_bits = true", "duty_bits must be a whole number"),
        ("duty_bits = 12", "duty_bits = " + "9" * 400, "duty_bits"),
        ("duty_bits = 12", "duty_bits = " + "9" * 5000, "not a TOML file"),
        ("duty_bits = 12", "duty_bits = " + "[" * 5000, "nested deeper"),
        ("duty_bits = 12", "duty_bits = " + "[" * 30 + "]" * 30, "nested deeper"),
        ("duty_bits = 12", ".".join("a" * 5000) + " = 1", "more than 64 parts"),
        ("duty_bits = 12", ".".join(['"a $"'] * 5000) + " = 1", "more than 64 parts"),
        ("duty_bits = 12", ".".join((["a"] * 63 + ['"' + "x" * 101 + '"']) * 80) + " = 1", "more than 64 parts"),
        ("duty_bits = 12", "x = { " + " . ".join(["'a\"'"] * 5000) + " = 1 }", "more than 64 parts"),
        ('title = "', 'title = "\\u001b[31m', "title"),
        ('voltage = "12 V"', "voltage = { value = " + "9" * 400 + ', unit = "V" }', "an integer of 40"),
    ],
)
def test_a_hostile_device_file_is_refused_in_one_line(old: str, new: str, told: str) -> None:
    text = OMNI.replace(old, new, 1) if old in OMNI else f'x = "{OMNI[:3]}"\n{OMNI}'
    with pytest.raises(DeviceError) as refused:
        parse(text, "x")
    assert told in str(refused.value)
    assert len(str(refused.value).splitlines()) == 1
    assert len(str(refused.value)) < 300


def test_names_that_no_file_can_have_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UnknownName):
        load("x" * 300)
    for name in (f"{'x' * 300}.toml", f"{'x/' * 3000}y.toml", "a\0.toml", str(tmp_path)):
        with pytest.raises((DeviceError, UnknownName)) as refused:
            load(name if name != str(tmp_path) else f"{name}/")
        assert len(str(refused.value).splitlines()) == 1
    with pytest.raises(DeviceError, match="regular file"):
        load("/dev/zero")
    pipe = tmp_path / "pipe.toml"
    os.mkfifo(pipe)
    with pytest.raises(DeviceError, match="regular file"):  # and is not waited for
        load(pipe)
    long = f'based_on = "{"y" * 300}.toml"\nname = "mine"\ntitle = "mine"\n'
    with pytest.raises(DeviceError, match="cannot be read"):
        parse(long, "x")


def test_a_file_of_text_has_an_end(tmp_path: Path) -> None:
    long = tmp_path / "long.toml"
    long.write_text('title = "x"\n#' + "x" * 300_000)
    with pytest.raises(DeviceError, match=r"long\.toml: cannot be read \(longer than 262144 bytes\)"):
        load(long)


def test_names_that_no_file_can_have_are_refused_for_writing_as_well(hostile: ModuleType, tmp_path: Path) -> None:
    good = {kind.name: kind.good for kind in hostile.kinds(tmp_path)}
    (tmp_path / "a.mcap").write_bytes(good["recording"])
    recording, calibration = Recording(tmp_path / "a.mcap"), Calibration.parse(good["calibration"].decode(), "it")
    for name in ("x" * 300, "x" * 252):
        with pytest.raises(RecordingError):
            recording.to_csv(tmp_path / name)
        with pytest.raises(CalibrationError):
            write_calibration(calibration, tmp_path / name)
    with pytest.raises(RecordingError):
        destination.create_recording(tmp_path / ("x" * 300), overwrite=None)
    with pytest.raises(RecordingError):
        destination.create_recording(tmp_path / "a\0b", overwrite=None)


@pytest.mark.parametrize("value", [[2.4], (2.4,), True, 10**400, float("nan"), "2.4", None, {"a": 1}, [[1.0]]])
def test_a_number_is_a_number_wherever_a_world_is_changed(value: Any) -> None:
    with pytest.raises(InputError):
        worlds.Dome().replace(moment=value)
    with pytest.raises(InputError):
        change_world(worlds.Dome(), *parse_request(request(1, "dome", {"moment": value}))[1:3])
    with pytest.raises(InputError):
        worlds.Dome().replace(summit=[0.0, 0.0, value])


def test_numbers_of_numpy_are_numbers() -> None:
    assert worlds.Dome().replace(moment=np.array(2.4)).moment == 2.4
    assert worlds.Dome().replace(moment=np.float64(2.4)).moment == 2.4
    assert worlds.Dome().replace(summit=np.array([0.0, 0.0, 1.0])).summit == (0.0, 0.0, 1.0)


@pytest.mark.parametrize("text", ["[trials]\nrepetitions = true", "[parameters]\nmoment = true",
                                  "[parameters]\nmoment = " + "9" * 400, "[trials]\nseed = " + "9" * 30,
                                  "[trials]\ntime_limit = \"3\""])  # fmt: skip
def test_a_study_takes_no_truth_and_no_text_for_a_number(text: str) -> None:
    with pytest.raises(InputError, match="study file"):
        study_of(f'name = "x"\n{text}')


@pytest.mark.parametrize("value", ["true", '"1"', "9" * 400, "[[1]]", "1e999", "1e300"])
def test_a_measured_number_is_a_number(value: str) -> None:
    with pytest.raises(CalibrationError):
        numbers(
            parse_document(f'{{"format": "a", "x": {value}}}', "FILE", "a", "a", {"format", "x"}, ""), "x", "FILE", ()
        )


@pytest.mark.parametrize("mask", [0o022, 0o077, 0o027, 0o002, 0o000])
def test_a_recording_is_as_open_as_its_owner_wants_files(tmp_path: Path, mask: int) -> None:
    before = os.umask(mask)
    try:
        descriptor = destination.create_recording(tmp_path / "a.mcap", overwrite=None)
        during = os.fstat(descriptor).st_mode & 0o777
        destination.complete(descriptor, temporary=False)
        after = os.fstat(descriptor).st_mode & 0o777
        os.close(descriptor)
        place, descriptor, _ = destination.create_temporary()
        destination.complete(descriptor, temporary=True)
        temporary = os.fstat(descriptor).st_mode & 0o777
        os.close(descriptor)
        place.unlink()
    finally:
        os.umask(before)
    assert during == 0o444 & ~mask
    assert after == 0o666 & ~mask
    assert temporary == 0o600


def test_a_chunk_that_says_it_is_a_gigabyte_is_refused_before_it_is_made(hostile: ModuleType, tmp_path: Path) -> None:
    path = tmp_path / "bomb.mcap"
    path.write_bytes(hostile.MAGIC + hostile.mcap_chunk(b"", claimed=10**9))
    with pytest.raises(RecordingError, match="claims 1000000000 bytes"):
        Recording(path)
    bomb = hostile.mcap_chunk(bytes(65 * 1024 * 1024), claimed=64)  # it is larger than its record says
    path.write_bytes(hostile.MAGIC + bomb)
    with pytest.raises(RecordingError, match="claims"):
        Recording(path)
    channel = b"\x05" + (22).to_bytes(8, "little") + bytes(22)  # one message, a million times
    path.write_bytes(hostile.MAGIC + hostile.mcap_chunk(channel * 1_000_000) * 9)  # all together
    with pytest.raises(RecordingError, match="claims"):
        Recording(path)
    other = b"\x05" + (23).to_bytes(8, "little") + bytes(23)  # never two alike in a row
    path.write_bytes(hostile.MAGIC + hostile.mcap_chunk((channel + other) * 500_000))
    with pytest.raises(RecordingError, match="more records"):
        Recording(path)


def list_again(content: bytes, opcode: int, times: int, offset: int | None = None) -> bytes:
    """The recording, whose summary lists its last record of that index so many times more, with the right check sum;
    offset: instead of where the record is."""
    start = struct.unpack_from("<Q", content, len(content) - 28)[0]
    end, at, found = len(content) - 37, start, (0, 0)
    summary, counts = bytearray(), 0
    while at < end:
        length = 9 + struct.unpack_from("<Q", content, at + 1)[0]
        if content[at] == 11:
            counts = len(summary)
        found = (at, length) if content[at] == opcode else found
        summary += content[at : at + length]
        at += length
    more = bytearray(content[found[0] : sum(found)])
    if offset is not None:
        struct.pack_into("<Q", more, 9 if opcode == 13 else 25, offset)
    place = counts + 9 + (18 if opcode == 13 else 22)  # the number of notes, or of chunks
    struct.pack_into("<I", summary, place, struct.unpack_from("<I", summary, place)[0] + times)
    summary += bytes(more) * times + content[end : end + 9] + struct.pack("<QQ", start, 0)
    return content[:start] + bytes(summary) + struct.pack("<I", zlib.crc32(summary)) + content[-8:]


@pytest.mark.parametrize("opcode", [8, 13])
@pytest.mark.parametrize("offset", [None, 9, 2**64 - 1, 2**64 - 40, 2**63])
def test_an_index_that_lists_a_record_again_makes_no_more_of_it(
    hostile: ModuleType, tmp_path: Path, opcode: int, offset: int | None
) -> None:
    layout, file = RowLayout(3, 2), io.BytesIO()
    recorder = Recorder(file, layout, 1000.0, 0)
    recorder.add_metadata("error", {"text": "x" * 100_000})
    recorder.append(np.zeros((300, layout.width)))
    recorder.finish()
    path = tmp_path / "run.mcap"
    path.write_bytes(file.getvalue())
    good = Recording(path)
    path.write_bytes(list_again(file.getvalue(), opcode, 0))
    assert Recording(path).notes == good.notes
    path.write_bytes(list_again(file.getvalue(), opcode, 100, offset))
    found = Recording(path)
    assert found.notes == good.notes
    assert found.rows.tobytes() == good.rows.tobytes()


def test_worlds_with_more_memory_than_rows_can_hold_are_refused(tmp_path: Path) -> None:
    layout = RowLayout(3, 2, memory=2000)
    path = tmp_path / "run.mcap"

    def write(worlds: int) -> Recording:
        with path.open("wb") as file:
            recorder = Recorder(file, layout, 1000.0, 0)
            for n in range(worlds):
                field = {"name": "it", "unit": "m", "shape": [2000]}
                text = json.dumps({"name": f"world{n}", "memory": [field]})
                recorder.add_metadata("world", {"change": str(n), "tick": "0", "world": text})
            recorder.append(np.zeros((30, layout.width)))
            recorder.finish()
        return Recording(path)

    assert len(write(8).memory) == 8
    many = write(100)
    for read in (lambda: many.memory, lambda: many.columns, lambda: many.to_csv(tmp_path / "run.csv")):
        with pytest.raises(RecordingError, match="more memory"):
            read()


def test_cells_that_spreadsheets_would_compute_are_text(tmp_path: Path) -> None:
    study = study_of('name = "x"\n[[questions]]\nname = "note"\ntext = "=cmd"\n[[questions]]\nname = "n"\ntext = "n?"')
    told = {"P1": {"note": '=HYPERLINK("x")', "n": "-3"}, "@P": {"note": "+1+1", "n": "\t=1"}, "P3": {"note": "fine"}}
    nobody = {name: np.empty(0) for name in COLUMNS}
    path = write_csv(study, nobody, tmp_path / "trials.csv", replies=told)[-1]
    rows = path.read_text(encoding="utf-8").splitlines()
    assert rows[1:] == [
        'P1,note,\'=cmd,"\'=HYPERLINK(""x"")"',
        "P1,n,n?,-3",
        "'@P,note,'=cmd,'+1+1",
        "'@P,n,n?,'\t=1",
        "P3,note,'=cmd,fine",
    ]
