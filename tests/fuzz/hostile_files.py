"""Effect of damaged and crafted files on all readers: an explained rejection, or the intended content.

    python tests/fuzz/hostile_files.py [--mutants 10000] [--commands 1000] [--seed 0] [--only device recording …]

Every kind of file that haptorb reads is changed at random: bytes flipped, cut out, put in and repeated, and numbers,
texts and brackets replaced by what has hurt readers before (numbers of 400 digits, NaN, expressions for units, lists
for numbers, control characters, names of 300 characters, a thousand brackets). A reader may return, or raise one of
haptorb's own errors, whose message is short and without control characters; nothing may take two seconds or half a
gigabyte. One line per kind, and a verdict; exit code 1 if anything else happened.

Then `--commands` of each kind, and 500 crafted files, go through the commands themselves, in forked processes that are
watched: no code of a file runs, no program is started, nothing outside is opened (tests/fuzz/hostile_commands.py).
"""

from __future__ import annotations

import argparse
import io
import json
import random
import re
import resource
import struct
import sys
import tempfile
import time
import traceback
import warnings
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from importlib.resources import files
from pathlib import Path

import numpy as np
import zstandard

from haptorb import worlds
from haptorb.cli.calibration_progress import ProgressFile
from haptorb.cli.calibration_steps import STEPS, calibration_of
from haptorb.cli.thermal_record import thermal_record
from haptorb.cli.world_option import parse_settings
from haptorb.devices.loader import load
from haptorb.errors import CalibrationError, HaptorbError, RecordingError, RecordingWarning
from haptorb.estimation.calibration_file import Calibration, read_calibration, read_frame
from haptorb.estimation.load_cell_calibration import list_columns, read_loads
from haptorb.estimation.network import Perceptron, Scaling, TrainedNetworks, read_networks, write_networks
from haptorb.estimation.tracker_frame import TrackerFrame
from haptorb.recording.mcap import Recorder
from haptorb.recording.recording import Recording
from haptorb.recording.row import RowLayout
from haptorb.runtime.hand_file import read_hand
from haptorb.runtime.trackers.replay import load_poses
from haptorb.runtime.world_requests import change_world, parse_request, request
from haptorb.worlds.base import parameters
from haptorb_study.feel.designs import load_designs
from haptorb_study.feel.session import FeelSession
from haptorb_study.study_file import read_study

SLOW = 2.0  #: of the processor's time for one file [s]
MEMORY = 512 * 1024  #: more than before, for all files of a kind [kB]

NINES = "9" * 400
HOSTILE = [
    "0", "-1", "1e999", "-1e308", "1e-320", "nan", "inf", "-inf", "true", "null", "[]", "{}", '""', "[2.4]", "[[[1]]]",
    NINES, "-" + NINES, "9" * 5000, "[" * 2000, "{" * 2000, '{"a":' * 300 + "1" + "}" * 300, "a." * 3000 + "b = 1",
    '"45 m**9**9**9"', '"1 m/0"', '"1 (m"', '"1 ' + "(" * 500 + 'm"', '"1 m*m*m*m*m*m*m*m*m*m"', '"1 yottaparsec^9"',
    '"1e400 mm"', f'"{NINES} mm"', '"inf mm"', '"nan mm"', '"1 \\u0000mm"', '"\\u001b[31m"', '"\\ud800"', '"=1+1"',
    f'"{"x" * 300}"', f'"{"x" * 100_000}"', f"{'k' * 300} = 1", '"../../etc/passwd"', '"/dev/zero"', '"\\n"',
    "'''", '"""', "\x00", "\r", "\u2028", "[a]", "[[a]]", "99999", "2**63", "18446744073709551616", "1979-05-27",
]  # fmt: skip
_TOKEN = re.compile(rb'"[^"\n]*"|-?[0-9][0-9.eE+-]*|\btrue\b|\bfalse\b|\bnull\b|\[[^\[\]\n]*\]|[A-Za-z_]+')


def mutant(good: bytes, chance: random.Random, *, text: bool) -> bytes:
    """`good`, changed in one to three places."""
    data = good
    for _ in range(chance.choice((1, 1, 1, 2, 3))):
        if text and chance.random() < 0.7:
            tokens = list(_TOKEN.finditer(data))
            if tokens:
                token = chance.choice(tokens)
                data = data[: token.start()] + chance.choice(HOSTILE).encode() + data[token.end() :]
            continue
        at, width = chance.randrange(len(data) + 1), chance.choice((1, 1, 2, 4, 8, 40, 400))
        kind = chance.randrange(6)
        if kind == 0 and data:
            at = min(at, len(data) - 1)
            data = data[:at] + bytes([data[at] ^ 1 << chance.randrange(8)]) + data[at + 1 :]
        elif kind == 1:
            data = data[:at] + data[at + width :]
        elif kind == 2:
            data = data[:at] + chance.randbytes(width) + data[at:]
        elif kind == 3:
            data = data[:at] + data[at : at + width] * chance.choice((2, 3, 50)) + data[at + width :]
        elif kind == 4:
            data = data[:at]
        else:
            extreme = chance.choice((b"\x00", b"\xff", b"\x7f")) * width
            data = data[:at] + extreme + data[at + width :]
    return data


def mcap_record(opcode: int, content: bytes) -> bytes:
    """One record of an MCAP file."""
    return bytes([opcode]) + struct.pack("<Q", len(content)) + content


def mcap_chunk(content: bytes, *, claimed: int | None = None, compression: str = "zstd") -> bytes:
    """A chunk with the right check sum around `content`, that says it is `claimed` bytes long."""
    packed = zstandard.ZstdCompressor().compress(content) if compression == "zstd" else content
    name = compression.encode()
    return mcap_record(
        6,
        struct.pack("<QQQII", 0, 0, len(content) if claimed is None else claimed, zlib.crc32(content), len(name))
        + name
        + struct.pack("<Q", len(packed))
        + packed,
    )


def mcap_text(text: bytes) -> bytes:
    """A text as MCAP writes it."""
    return struct.pack("<I", len(text)) + text


MAGIC = b"\x89MCAP0\r\n"


def craft_recording(good: bytes, chance: random.Random) -> bytes:
    """A file whose frame is right and whose content is not: check sums fit, so that it is looked into."""
    name, topic = b"haptorb/msg/Tick", b"/haptorb/tick"
    field_line = chance.choice(
        (b"float64 t", b"float64[0] t", b"float64[999999] t", b"float64[" + b"9" * 5000 + b"] t", b"int8 t",
         b"\xff\xfe", b"float64 t\nfloat64 t", b"float64[3] t\nfloat64[2] p\nfloat64 age\nfloat64 valid", b"")
    )  # fmt: skip
    schema = mcap_record(3, b"\x01\x00" + mcap_text(name) + mcap_text(b"ros2msg") + mcap_text(field_line + b"\n"))
    channel = mcap_record(4, b"\x00\x00" + b"\x01\x00" + mcap_text(topic) + mcap_text(b"cdr") + struct.pack("<I", 0))
    pairs = mcap_text(chance.choice((b"rows", b"channels", b"digest"))) + mcap_text(
        chance.choice((b"-1", b"", b"x" * 99))
    )
    note = mcap_record(12, mcap_text(chance.choice((b"haptorb/gap", b"haptorb/layout"))) + mcap_text(pairs))
    message = mcap_record(5, struct.pack("<HIQQ", 0, 0, 0, 0) + b"\x00\x01\x00\x00" + bytes(8 * chance.randrange(6)))
    inner = (
        schema + channel + note + message * chance.randrange(4) + chance.choice((b"", b"\x05", bytes(9), b"\x05" * 30))
    )
    parts = [
        mcap_chunk(inner),
        mcap_chunk(inner, claimed=chance.choice((0, 10**9, 2**63, 2**64 - 1, len(inner) - 1))),
        mcap_chunk(bytes(chance.choice((10, 10**6, 3 * 10**7)))),
        mcap_chunk(mcap_chunk(mcap_chunk(inner))),
        mcap_chunk(inner, compression=chance.choice(("", "lz4", "none", "\x00"))),
        mcap_record(chance.choice((3, 4, 5, 6, 12)), chance.randbytes(chance.randrange(60))),
        schema + channel + message + note,
        good[8:],
    ]
    return MAGIC + b"".join(chance.sample(parts, chance.randrange(1, 4)))


@dataclass
class Kind:
    """One kind of file: a good one, and what reads it."""

    name: str
    good: bytes
    ending: str
    read: Callable[[Path], object]
    text: bool = True
    make: Callable[[bytes, random.Random], bytes] | None = None  #: crafted ones, a third of all


@dataclass
class Outcomes:
    """What the files of a kind did."""

    files: int = 0
    read: int = 0
    refused: int = 0
    slowest: float = 0.0
    memory: int = 0  #: [kB]
    wrong: list[str] = field(default_factory=list)  #: what should not have happened


def try_mutants(kind: Kind, mutants: int, seed: int, folder: Path) -> Outcomes:
    """Read so many mutants of `kind` in `folder`."""
    chance, found, before = random.Random(f"{kind.name} {seed}"), Outcomes(), _memory()
    kind.read(_write(folder, kind, kind.good))
    for number in range(mutants):
        if kind.make is not None and number % 3 == 0:
            data = kind.make(kind.good, chance)
        else:
            data = mutant(kind.good, chance, text=kind.text)
        path, start = _write(folder, kind, data), time.process_time()
        found.files += 1
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                warnings.simplefilter("ignore", RecordingWarning)  # of a damaged file, whose other rows are read
                kind.read(path)
            found.read += 1
        except HaptorbError as told:
            found.refused += 1
            message = str(told)
            if len(message) > 20_000 or re.search(r"[\x00-\x09\x0b-\x1f\x7f]", message):
                found.wrong.append(f"{kind.name} {number}: a message of {len(message)} characters: {message[:200]!r}")
        except Exception:
            found.wrong.append(f"{kind.name} {number}: {traceback.format_exc(limit=-4)}")
        took = time.process_time() - start
        found.slowest = max(found.slowest, took)
        if took > SLOW:
            found.wrong.append(f"{kind.name} {number}: {took:.1f} s")
    found.memory = _memory() - before
    if found.memory > MEMORY:
        found.wrong.append(f"{kind.name}: {found.memory / 1024:.0f} MB more memory than before")
    return found


def _memory() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def _write(folder: Path, kind: Kind, data: bytes) -> Path:
    path = folder / f"file{kind.ending}"
    path.write_bytes(data)
    return path


STUDY = b"""
name = "one"
procedure = "staircase"
instructions = "Which is stronger?"
[parameters]
moment = 1.2
[set_points]
points = [{ number = 1, theta_deg = 0 }, { number = 2, theta_deg = 36.5, phi_deg = -20 }]
[trials]
repetitions = 2
order = "random"
seed = 7
time_limit = 20.0
[[conditions]]
name = "a"
parameters = { moment = 1.0 }
[[conditions]]
name = "b"
[levels]
reference = 1.2
least = 0.01
most = 1.0
start = 0.8
values = [1.0, 1.4]
[rating]
question = "How well?"
low = 0
high = 10
[mask]
noise = "pink"
volume_db = -20
[[questions]]
name = "age"
text = "How old are you?"
low = 18
high = 99
"""

LOADS = (
    ",".join(list_columns(load("omni")))
    + "\n"
    + "".join(  # type: ignore[arg-type]
        f"{0.03 * (n % 3 - 1):g},{0.03 * (n // 3 % 3 - 1):g},0.055,0,0,0,1,{n % 3},{n % 5 - 2},{n % 4},0.1,0,"
        f"{n / 50:g},0,0.001,0\n"
        for n in range(16)
    )
)
THERMAL = "t_s,power_w,winding_degc,boundary_degc\n" + "".join(
    f"{t},10.5,{25 + t / 10},{24 + t / 20}\n" for t in range(40)
)

HAND = (
    "# over the dome, onto it, along it\nstart 0 0 62 mm\nmove 0 0 48 mm in 1.5 s\npress a\nwait 300 ms\nrelease a\n"
    "line 10 0 49 mm turn 0 10 0 ° in 0.5 s\nturn 0 0 0 ° in 1 s\ngrip 20 mm in 0.2 s\n"
).encode()
HAND_TABLE = "t [ms],x [mm],y [mm],z [mm],psi [°],lambda [°],phi [°],grip [mm],buttons\n" + "".join(
    f"{10 * n},{n / 10},0,{60 - n / 5},0,{n},0,{n % 9},{'ab'[: n % 3]}\n" for n in range(40)
)


def kinds(folder: Path) -> list[Kind]:
    """All that haptorb reads; good files are made in `folder`."""
    catalogue = files("haptorb.devices") / "catalogue"
    omni = load("omni")
    n = omni.channels
    calibration = Calibration(
        "omni", omni.digest, 0.2 * np.eye(n), np.eye(n), np.zeros((9, 3)), np.ones(n), 0.0, 1.0, 0.0, None, True
    )
    frame = TrackerFrame(
        "omni", omni.digest, "osc:9000", True, np.eye(3), np.zeros(3), np.zeros(3), np.array([0, 0, 0.01]),
        np.array([0.0, 0.0, 1.0]), 1e-4, 4.5, 1e-4, 3e-3,
    )  # fmt: skip

    def of_calibration(path: Path) -> object:
        return read_calibration(path).apply(omni)

    def of_frame(path: Path) -> object:
        return read_frame(path).check_for(omni, "osc:9000").transform_pose((0.0, 0.0, 0.1), (0.0, 0.0, 0.0, 1.0))

    def of_parameters(path: Path) -> object:
        lines = path.read_bytes().decode("utf-8", "replace").split("\n")
        world = worlds.Dome().replace(**parse_settings([line for line in lines[1:] if line], parameters(worlds.Dome)))
        try:
            values = json.loads(lines[0])
        except (ValueError, RecursionError):
            return world
        if not isinstance(values, dict):
            return world
        _, name, values, _ = parse_request(request(1, "dome", values))
        return change_world(world, name, values)

    def of_recording(path: Path) -> object:
        recording = Recording(path)
        read: list[Callable[[], object]] = [
            lambda: (recording.metadata, recording.worlds),
            lambda: recording.lost,
            lambda: recording.layout,
            lambda: recording.to_csv(path.with_suffix(".csv"), overwrite=True),
            lambda: load_poses(path),
            lambda: read_hand(path, omni),
            lambda: thermal_record(path, omni),
        ]
        refused: HaptorbError | None = None
        for one in read:
            try:
                one()
            except HaptorbError as told:
                refused = refused or told
        if refused:
            raise refused
        return recording

    alone = replace(omni, coils=replace(omni.coils, heat=replace(omni.coils.heat, coupling=None)))

    def of_thermal(path: Path) -> object:
        return thermal_record(path, alone)

    def of_progress(path: Path) -> object:
        progress = ProgressFile(path.with_name("file"), omni, "sim", lambda: 1000.0)
        for step in STEPS:
            if step.name in progress.results:
                step.describe(omni, progress.results[step.name])
        if {"rest", "currents", "magnetic"} <= set(progress.results):
            return calibration_of(omni, progress.results, True)
        if progress.left:
            raise CalibrationError(progress.left)
        return progress

    designs = load_designs(Path(str(files("haptorb_study.feel") / "example.toml")))

    def of_ratings(path: Path) -> object:
        (folder / "session").mkdir(exist_ok=True)
        (folder / "session" / "ratings.jsonl").write_bytes(path.read_bytes())
        session = FeelSession(folder / "session", designs)
        read = session.ratings(), session.choice(), session.scores(), session.find_outdated()
        if session.skipped:
            raise RecordingError(f"{session.skipped} lines were skipped")
        return read

    layout, file = RowLayout(3, 2), io.BytesIO()
    recorder = Recorder(file, layout, 1000.0, 10**18)
    recorder.add_metadata("device", {"name": "omni", "digest": omni.digest})
    recorder.add_metadata("gap", {"rows": "3", "after": "4"})
    rows = np.random.default_rng(0).normal(size=(60, layout.width))
    rows[:, layout["t"]] = rows[:, layout["wall"]] = np.arange(60)[:, None] / 1000.0
    rows[:, layout["valid"]], rows[:, layout["age"]] = 1.0, 0.001
    rows[:, layout["hand_goal"]] *= 0.05
    rows[:, layout["hand_goal_q"]], rows[:, layout["grip"]] = (0.0, 0.0, 0.0, 1.0), 0.02
    recorder.append(rows)
    recorder.finish()

    progress = ProgressFile(folder / "good", omni, "sim", lambda: 1000.0)
    progress.store("rest", {"temperatures_k": [298.0] * 3})
    progress.store("currents", {"resistance_ohm": [0.6] * 3})
    progress.store("magnetic", {
        "moment_per_current_m2": (0.2 * np.eye(n)).tolist(), "uncertainty_m2": np.eye(n).tolist(),
        "offsets_t": np.zeros((9, 3)).tolist(), "residual_t": 1e-5, "condition": 2.0, "repeatability": 1e-4,
        "failed": [],
    })  # fmt: skip
    progress.store("tool", {"likeness": 0.9, "strength": 1.0})

    scaling = Scaling(np.zeros(2), np.ones(2)), Scaling(np.zeros(1), np.ones(1))
    network = Perceptron(np.ones((3, 3)), np.ones((1, 4)), *scaling)
    write_networks(TrainedNetworks("pmsm", "d" * 64, 0.5, (network,), {"nodes": 3}), folder / "good.network")

    line = json.dumps({"kind": "rating", "design": "firm", "digest": "0" * 16, "score": 5, "person": "P", "comment": "",
                       "time": "", "trace": ""})  # fmt: skip
    choice = json.dumps({"kind": "choice", "design": "firm", "digest": "0", "person": "", "comment": "", "time": ""})
    world_values = json.dumps({"moment": 1.5, "summit": [0.0, 0.0, 1.0]}) + "\nmoment=1.2\nsummit=0,0,1\n"
    return [
        Kind("device", (catalogue / "omni.toml").read_bytes(), ".toml", load),
        Kind("motor", (catalogue / "pmsm.toml").read_bytes(), ".toml", load),
        Kind("variant", (catalogue / "pmsm-in-phase.toml").read_bytes(), ".toml", load),
        Kind("design", (files("haptorb_study.feel") / "example.toml").read_bytes(), ".toml", load_designs),
        Kind("study", STUDY, ".toml", read_study),
        Kind("calibration", calibration.text().encode(), ".json", of_calibration),
        Kind("frame", frame.text().encode(), ".json", of_frame),
        Kind("parameters", world_values.encode(), ".txt", of_parameters),
        Kind("recording", file.getvalue(), ".mcap", of_recording, text=False, make=craft_recording),
        Kind("network", (folder / "good.network").read_bytes(), ".network", read_networks, make=_seal),
        Kind("progress", progress.path.read_bytes(), ".steps", of_progress),
        Kind("ratings", f"{line}\n{choice}\n{line}\n".encode(), ".jsonl", of_ratings),
        Kind("thermal", THERMAL.encode(), ".csv", of_thermal),
        Kind("loads", LOADS.encode(), ".csv", lambda path: read_loads(path, omni)),
        Kind("hand", HAND, ".hand", lambda path: read_hand(path, omni)),
        Kind("hand table", HAND_TABLE.encode(), ".csv", lambda path: read_hand(path, omni)),
    ]


def _seal(good: bytes, chance: random.Random) -> bytes:
    """A network file with another head, whose hash is right."""
    from haptorb.estimation.network import _digest

    line, _, numbers = good.partition(b"\n")
    head = json.loads(line)
    del head["sha256"]
    key = chance.choice(list(head))
    shapes = (
        [],
        [[]],
        [[-1, 3]],
        [[10**400]],
        [[2**62, 4]],
        "text",
        [[3, 3]] * 7,
        [[3, 3], [1, 4], [2], [2], [1], [2]],
    )
    head[key] = chance.choice((*shapes, None, True, 10**400, "x" * 300, {"a": [[[]]]}))
    if chance.random() < 0.3:
        numbers = chance.choice((numbers[:-8], numbers + bytes(8), numbers[:-3], b"\xff" * len(numbers), b""))
    return json.dumps({**head, "sha256": _digest(head, numbers)}).encode() + b"\n" + numbers


def try_all_commands(mutants: int, seed: int, only: list[str] | None) -> int:
    """Mutants of each kind, and crafted files, through the commands in watched processes; how many ended otherwise."""
    sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))
    from fuzz.hostile_commands import COMMANDS, FURTHER, craft_files, make_ground, try_commands, try_files

    wrong = 0
    for kind in [*COMMANDS, *FURTHER, None]:
        name = "crafted" if kind is None else kind if isinstance(kind, str) else kind.name.lower()
        if mutants < 1 or (only and name not in only):
            continue
        text = name not in ("recording", "results", "study_database", "network", "picture")
        with tempfile.TemporaryDirectory() as place:
            if kind is None:
                inside, outside = make_ground(Path(place, "ground"))
                found = try_files(list(craft_files(inside, outside)), inside, outside)
            else:
                ground = Path(place, "ground")
                # Of results a page with cards and drawings of designs is made.
                count = mutants // 10 if name == "results" else mutants
                found = try_commands(kind, count, seed, ground, partial(mutant, text=text))
        wrong += len(found.wrong)
        print(
            f"{name:12} {found.files:6} files through commands: {found.read} read, {found.refused} refused, "
            f"{len(found.wrong)} otherwise; slowest {1e3 * found.slowest:.0f} ms",
            flush=True,
        )
        for what in found.wrong[:5]:
            print(what, file=sys.stderr)
    return wrong


def main() -> int:
    """Try all kinds, say what they did."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--mutants", type=int, default=10_000, help="of each kind; a tenth of that of motors")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="*", help="kinds")
    parser.add_argument(
        "--commands",
        type=int,
        default=1000,
        help="of each kind, through each command that reads it; a tenth of that of results",
    )
    given = parser.parse_args()
    wrong = 0
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        for kind in kinds(folder):
            if given.mutants < 1 or (given.only and kind.name not in given.only):
                continue
            mutants = given.mutants // 10 if kind.name in ("motor", "variant") else given.mutants
            found = try_mutants(kind, mutants, given.seed, folder)
            wrong += len(found.wrong)
            print(
                f"{kind.name:12} {found.files:6} files: {found.read} read, {found.refused} refused, "
                f"{len(found.wrong)} otherwise; slowest {1e3 * found.slowest:.0f} ms, {found.memory / 1024:.0f} MB",
                flush=True,
            )
            for what in found.wrong[:5]:
                print(what, file=sys.stderr)
    wrong += try_all_commands(given.commands, given.seed, given.only)
    print("every file was read or refused in words" if not wrong else f"{wrong} files ended otherwise")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
