"""Damaged and crafted files through the commands, in monitored forked processes.

A child takes one file after the other through `haptorb.cli.main`. An audit hook of Python sees what it opens,
imports and starts; the parent sees how it ends. Wrong is: an exit code other than 0, 1 and 2, a traceback, the end of
the interpreter, 2 s of the processor more than for a good file, a canary file that is opened, a canary module that is
imported or run, a program that is started, a socket that is connected, a file that is written elsewhere, a good file
that is refused. MuJoCo opens files in a process of its own, which no hook sees: of each form in which a scene can name
a file outside, one scene is complete with that file only, and must be refused.
"""

from __future__ import annotations

import contextlib
import gc
import gzip
import io
import json
import os
import pickle
import random
import resource
import shutil
import signal
import sqlite3
import struct
import sys
import tempfile
import traceback
import warnings
import zipfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import lz4.frame
import zstandard

from fuzz.good_files import NAMES, fill_whole
from fuzz.reading_scenes import READING, make_reading_scene, write_outside
from haptorb.file_kind import FileKind
from haptorb.worlds.scene_physics import load_engine

__all__ = ["COMMANDS", "FURTHER", "Watched", "craft_files", "make_ground", "try_commands", "try_files"]

K = FileKind
SLOW = 2.0  #: of the processor for one file, more than for a good one [s]
HUNG = 30.0  #: of the processor [s]: a busy computer is no fault of a file
WAITED = 900  #: by the clock [s], for what uses no processor
_loaded: set[str] = set()  #: commands whose code this process has loaded
OUTSIDE = "outside: "  #: begins the title of a file that is read only if one outside is read
GOOD = "a good file"  #: the title of a file that may not be refused: a command that reads none tries nothing

#: kind of file → the commands that read it
COMMANDS: dict[FileKind, tuple[str, ...]] = {
    K.RECORDING: (
        "info FILE --json",
        "export FILE -o out.csv --force",
        "export FILE -o out.npz --force",
        "replay FILE",
        "VIEW FILE",
        "TRACKER FILE",
    ),
    K.DEVICE: ("inspect FILE --json",),
    K.CALIBRATION: ("run omni --headless --duration 0.1 --calibration FILE",),
    K.FRAME: ("run omni --headless --duration 0.1 --tracker osc:9000 --frame FILE",),
    K.HAND: ("run omni --headless --duration 0.1 --hand FILE",),
    K.DESIGN: ("DESIGN FILE",),
    K.RESULTS: ("design report FILE -o out.html --best 1",),
    K.STUDY: ("study check FILE",),
    K.REGISTRATION: ("study analyse study.db --registration FILE",),
    K.STUDY_DATABASE: (
        "study participants FILE --json",
        "study export FILE trials.csv --force",
        "study merge FILE second.db --into made.db",
        "study withdraw FILE SIM01 --yes",
        "study backup FILE made.db",
    ),
    K.SCENE: ("check omni --scene FILE",),
    K.TABLE: ("THERMAL FILE",),
    K.FELT_DESIGNS: ("FEEL FILE",),
    K.NETWORK: ("NETWORK FILE",),
    K.PICTURE: ("PICTURE FILE",),
}

#: files of a kind that others have as well → the commands that read them
FURTHER: dict[str, tuple[str, ...]] = {
    "mapping.toml": ("MAPPING FILE",),
    "path.csv": ("PATH FILE",),
    "loads.csv": ("LOADS FILE",),
}


@dataclass
class Watched:
    """What a child did with a file."""

    wrong: list[str] = field(default_factory=list)
    files: int = 0
    read: int = 0  #: exit code 0 or 1
    refused: int = 0
    slowest: float = 0.0
    usual: dict[str, float] = field(default_factory=dict)  #: command → what a good file takes of the processor [s]


def make_ground(folder: Path) -> tuple[Path, Path]:
    """(where files lie and commands run, what lies outside) in `folder`: canaries, a pipe, links."""
    inside, outside = folder / "inside", folder / "outside"
    inside.mkdir(parents=True)
    write_outside(outside)
    fill_whole(inside)
    for form in READING:
        make_reading_scene(form, inside, outside)  # the files that it includes
    for name in ("canary.toml", "canary.xml", "canary.obj", "canary.mcap", "canary.png"):
        (outside / name).write_text("name = 'canary'\n")
    mark = outside / "RAN"
    code = f"from pathlib import Path\nPath({str(mark)!r}).touch()\n\n\nclass Canary:\n    pass\n"
    for place in (inside, outside):
        (place / "canary_module.py").write_text(code)
    os.mkfifo(inside / "pipe.toml")
    os.mkfifo(inside / "pipe.xml")
    (inside / "link.xml").symlink_to(outside / "canary.xml")
    (inside / "zero.toml").symlink_to("/dev/zero")
    return inside, outside


class _Watch:
    """The audit hook of a child; it cannot be removed, so it is told when to look."""

    def __init__(self, inside: Path, outside: Path) -> None:
        self.inside, self.outside = str(inside), str(outside)
        self.seen: list[str] = []
        self.looks = False

    def __call__(self, event: str, arguments: tuple[Any, ...]) -> None:
        if not self.looks:
            return
        if event in ("open", "sqlite3.connect", "os.remove", "os.rename", "os.mkdir"):
            place = arguments[0]
            text = os.fsdecode(place) if isinstance(place, str | bytes) else ""
            if self.outside in text or "canary_module" in text:
                self.seen.append(f"{event} {text}")
        elif event in ("os.system", "os.exec", "os.posix_spawn", "os.fork", "pty.spawn", "subprocess.Popen"):
            if "scene_compiler" not in str(arguments):
                self.seen.append(f"{event} {arguments!r:.200}")
        elif event == "import" and "canary" in str(arguments[0]):
            self.seen.append(f"import {arguments[0]}")
        elif event == "socket.connect":
            self.seen.append(f"{event} {arguments[1:]!r}")


def try_commands(
    kind: FileKind | str, mutants: int, seed: int, folder: Path, mutate: Callable[[bytes, random.Random], bytes]
) -> Watched:
    """The good file of `kind`, or of that name in FURTHER, which must be read, and so many damaged ones through each of
    its commands, on the ground in `folder`."""
    inside, outside = make_ground(folder)
    name, commands = (kind, FURTHER[kind]) if isinstance(kind, str) else (NAMES[kind], COMMANDS[kind])
    good = (inside / name).read_bytes()
    chance = random.Random(f"{name} {seed}")
    contents = [good, *(mutate(good, chance) for _ in range(mutants))]
    titles = [GOOD if n == 0 else f"{name} {n}" for n in range(len(contents))]
    return try_files([(title, command, name, content) for command in commands
                      for title, content in zip(titles, contents, strict=True)], inside, outside)  # fmt: skip


def try_files(tasks: Sequence[tuple[str, str, str, bytes]], inside: Path, outside: Path) -> Watched:
    """Each (title, command, name of the file, its content) in a forked process; the next one starts where one ended."""
    found, start = Watched(), 0
    load_engine()
    with (
        contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()), warnings.catch_warnings(),
    ):  # fmt: skip
        warnings.simplefilter("ignore", ResourceWarning)  # a command leaves to the end of its process what it has open
        wanted = {command for _, command, _, _ in tasks} - _loaded
        known = {NAMES[kind]: commands for kind, commands in COMMANDS.items()} | FURTHER
        for name, commands in known.items():  # loads what they need, once for all children
            content = (inside / name).read_bytes()
            with contextlib.chdir(inside):
                for command in wanted & set(commands):
                    _run(command.replace("FILE", name))
            _put(inside / name, content)
        _loaded.update(wanted)
        gc.collect()
    good = {name: (inside / name).read_bytes() for _, _, name, _ in tasks if (inside / name).is_file()}
    while start < len(tasks):
        start = _try_part(tasks, start, inside, outside, found)
    for name, content in good.items():
        _put(inside / name, content)
    if (outside / "RAN").exists():
        found.wrong.append("a canary was run")
    return found


def _try_part(
    tasks: Sequence[tuple[str, str, str, bytes]], start: int, inside: Path, outside: Path, found: Watched
) -> int:
    """From task `start` on until the child ends, at most 200; the number of the next one."""
    reading, writing = os.pipe()
    end = min(start + 200, len(tasks))
    pid = os.fork()
    if pid == 0:
        os.close(reading)
        _work(tasks[start:end], inside, outside, writing)
    os.close(writing)
    done = start
    with os.fdopen(reading) as lines:
        for line in lines:
            one = json.loads(line)
            title, command = tasks[done][:2]
            done += 1
            found.files += 1
            found.slowest = max(found.slowest, one["seconds"])
            found.read += one["code"] in (0, 1)
            found.refused += one["code"] == 2
            found.wrong += [f"{title} ({command}): {what}" for what in one["wrong"]]
            if title == GOOD:
                found.usual[command] = one["seconds"]
            if one["seconds"] > SLOW + found.usual.get(command, 0.0):
                found.wrong.append(f"{title} ({command}): {one['seconds']:.1f} s")
            if title.startswith(OUTSIDE) and one["code"] != 2:
                found.wrong.append(f"{title} ({command}): read a file outside")
            if title == GOOD and one["code"] == 2:
                found.wrong.append(f"{title} ({command}): refused: {one['said']}")
    status = os.waitpid(pid, 0)[1]
    if done < end:
        found.wrong.append(f"{tasks[done][0]} ({tasks[done][1]}): the interpreter ended with status {status}")
        done += 1
        found.files += 1
    return done


def _work(tasks: Sequence[tuple[str, str, str, bytes]], inside: Path, outside: Path, writing: int) -> None:
    """In the child: never returns."""
    try:
        with open(os.devnull, "rb") as nothing:
            os.dup2(nothing.fileno(), 0)
        os.chdir(inside)
        watch = _Watch(inside, outside)
        sys.addaudithook(watch)
        warnings.resetwarnings()  # as in a program: a test's would raise them
        for _, command, name, content in tasks:
            _put(inside / name, content)
            signal.setitimer(signal.ITIMER_PROF, HUNG)
            signal.alarm(WAITED)
            line = json.dumps(_try_one(command.replace("FILE", name), watch)) + "\n"
            signal.setitimer(signal.ITIMER_PROF, 0.0)
            signal.alarm(0)
            os.write(writing, line.encode())
    except BaseException:
        traceback.print_exc()
        os._exit(3)
    os._exit(0)


def _put(path: Path, content: bytes) -> None:
    """A new file: SQLite remembers one that it has open by its number."""
    for end in ("", "-wal", "-shm"):
        path.with_name(f"{path.name}{end}").unlink(missing_ok=True)
    path.write_bytes(content)


def _try_one(command: str, watch: _Watch) -> dict[str, Any]:
    said, start = io.StringIO(), _processor()
    watch.seen, watch.looks = [], True
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            code = _run(command)
    except Exception:
        code = -1
        said.write(traceback.format_exc(limit=-4))
    watch.looks = False
    took, wrong = _processor() - start, list(watch.seen)
    text = said.getvalue()
    if code not in (0, 1, 2) or "Traceback" in text:
        wrong.append(f"code {code}: {text[-900:]}")
    if any(ord(letter) < 32 and letter not in "\n\t" for letter in text):
        wrong.append(f"control characters: {text[-300:]!a}")
    return {"code": code, "seconds": took, "wrong": wrong, "said": text[-300:]}


def _read_loads(path: Path) -> None:
    from haptorb.devices.loader import load
    from haptorb.estimation.load_cell_calibration import read_loads

    read_loads(path, load("omni"))  # type: ignore[arg-type]


def _read_mapping(path: Path) -> None:
    from haptorb.runtime.trackers.formats import load_mapping, make_reader

    make_reader(load_mapping(path))


def _read_network(path: Path) -> None:
    from haptorb.estimation.network import read_networks

    read_networks(path)


def _read_path(path: Path) -> None:
    from haptorb.worlds import load_path

    load_path(path)


def _read_picture(path: Path) -> None:
    from haptorb.worlds import Terrain

    _ = Terrain.image(path).bound


def _read_poses(path: Path) -> None:
    from haptorb.runtime.trackers.replay import load_poses

    load_poses(path)


#: what has no command that ends at once: the function behind it
_READERS: dict[str, Callable[[Path], None]] = {
    "LOADS": _read_loads, "MAPPING": _read_mapping, "NETWORK": _read_network, "PATH": _read_path,
    "PICTURE": _read_picture, "TRACKER": _read_poses,
}  # fmt: skip


def _run(command: str) -> int:
    """The exit code; of what waits for people, or for a loop, what it does with the file before that."""
    from haptorb.errors import HaptorbError

    name, *words = command.split()
    Path("made.db").unlink(missing_ok=True)  # made by the command before
    try:
        if name in _READERS:
            _READERS[name](Path(words[0]))
        elif name == "VIEW":
            from haptorb.web.view import Viewer

            Viewer([Path(words[0])], 0)
        elif name == "FEEL":
            from haptorb_study.feel.designs import load_designs

            load_designs(words[0])
        elif name == "DESIGN":
            from haptorb.cli.own_code import announce_code
            from haptorb_design.design_file import load_design
            from haptorb_design.sampling import sample

            sample(load_design(words[0], announce_code), "sobol", 1, 0)
        elif name == "THERMAL":
            from haptorb.cli.thermal_record import thermal_record
            from haptorb.devices.loader import load

            thermal_record(words[0], load("omni"))
        elif "--hand" in words:
            from haptorb.devices.loader import load
            from haptorb.runtime.hand_file import read_hand

            read_hand(words[-1], load("omni"))
        elif "--calibration" in words or "--frame" in words:
            from haptorb.devices.loader import load
            from haptorb.estimation.calibration_file import read_calibration, read_frame

            if "--frame" in words:
                read_frame(words[-1]).check_for(load("omni"), "osc:9000")
            else:
                read_calibration(words[-1]).apply(load("omni"))
        elif name == "check":
            from haptorb.worlds.scene import Scene

            Scene(words[-1])
        else:
            from haptorb.cli import main

            return main([name, *words])
    except HaptorbError as told:
        print(told)
        return 2
    except SystemExit as end:
        return int(end.code or 0) if isinstance(end.code, int | None) else -2
    return 0


def _processor() -> float:
    mine, others = resource.getrusage(resource.RUSAGE_SELF), resource.getrusage(resource.RUSAGE_CHILDREN)
    return mine.ru_utime + mine.ru_stime + others.ru_utime + others.ru_stime


def craft_files(inside: Path, outside: Path) -> Iterator[tuple[str, str, str, bytes]]:
    """(title, command, name, content) of files that name, hide or ask for what they should not: more than 400, of every
    kind that a command reads."""
    canary = str(outside / "canary")
    places = [f"{canary}.END", "../outside/canary.END", "link.END", "pipe.END", "zero.END", "/dev/zero", "/dev/stdin",
              "/dev/tty", "/proc/self/mem", "a/../../outside/canary.END", f"file://{canary}.END", "|touch RAN",
              "~/x.END", "~nobody/x.END", "x" * 5000, "nul\\u0000.END"]  # fmt: skip
    for place in places:
        for tag in ("mesh", "texture type='2d'", "hfield size='1 1 1 1'", "skin", "model"):
            name = place.replace("END", "xml").replace("\\u0000", "&#x1;").replace("|", "&#124;")
            text = f"<mujoco><asset><{tag} name='m' file='{name}'/></asset><worldbody/></mujoco>"
            yield f"scene {tag} {place[:40]}", COMMANDS[K.SCENE][0], "crafted.xml", text.encode()
        text = f"<mujoco><include file='{place.replace('END', 'xml')}'/></mujoco>"
        yield f"scene include {place[:40]}", COMMANDS[K.SCENE][0], "crafted.xml", text.encode()
        if "canary" in place or place.startswith("link"):
            continue  # a device file may name any other device file: it is TOML, and is read as such
        named = json.dumps(place.replace("END", "toml").replace("\\u0000", "\0"))
        yield f"device {place[:40]}", COMMANDS[K.DEVICE][0], "crafted.toml", f"name='a'\nbased_on={named}".encode()
        yield (
            f"design {place[:40]}",
            COMMANDS[K.DESIGN][0],
            "crafted.toml",
            (
                f"name='a'\nbase={named}\n[objectives.cost]\n[parameters.r]\nlow='1 mm'\nhigh='2 mm'\n"
                "places=['dome.radius']"
            ).encode(),
        )
        yield f"study {place[:40]}", COMMANDS[K.STUDY][0], "crafted.toml", f"name='a'\ndevice={named}".encode()
    for title, text in (
        ("replicate", "<replicate count='1e9'><geom size='1'/></replicate>"),
        ("nested", "<body>" * 5000 + "</body>" * 5000),
        ("composite", "<composite type='grid' count='9999 9999 9999' offset='1 1 1'/>"),
        ("memory", "</worldbody><size memory='900G'/><worldbody><body><freejoint/><geom size='1'/></body>"),
        ("numbers", f"<geom size='{'9' * 100_000}'/>"),
    ):
        yield (
            f"scene {title}",
            COMMANDS[K.SCENE][0],
            "crafted.xml",
            (f"<mujoco><worldbody>{text}</worldbody></mujoco>".encode()),
        )
    yield from _craft_recordings()
    yield from _craft_notes((inside / NAMES[K.RECORDING]).read_bytes(), canary)
    yield from _craft_databases(inside)
    yield from _craft_scenes(canary)
    for form in READING:
        content = make_reading_scene(form, inside, outside).read_bytes()
        yield f"{OUTSIDE}{form}", COMMANDS[K.SCENE][0], "reading.xml", content
    for kind, commands in COMMANDS.items():
        good = (inside / NAMES[kind]).read_bytes()
        contents = [*_craft_contents(kind, good)]
        for command in commands:
            for title, content in contents:
                yield f"{kind.name} {title}", command, f"crafted-{NAMES[kind]}", content
            for place in ("pipe.toml", "zero.toml", "/dev/zero", "/dev/stdin", "/proc/self/mem", "/proc/kmsg", "."):
                yield f"{kind.name} at {place}", command.replace("FILE", place), "unused", b""


def _craft_contents(kind: FileKind, good: bytes) -> Iterator[tuple[str, bytes]]:
    """(title, content): what hurts any reader, and what hurts those of text."""
    yield "empty", b""
    yield "zip bomb", _make_zip_bomb()
    yield "zstd bomb", b"\x89MCAP0\r\n" + _make_bomb("zstd")
    yield "lz4 bomb", b"\x89MCAP0\r\n" + _make_bomb("lz4")
    yield "gzip bomb", gzip.compress(bytes(64 << 20), 1)
    yield "pickle", pickle.dumps(_Payload())
    yield "begins well", good[: len(good) // 2] + b"\0" * 1000
    if kind in (K.RECORDING, K.RESULTS, K.STUDY_DATABASE):
        return
    yield "no text", bytes(range(256)) * 40
    yield "escapes", good + b'\n\x1b]52;c;Y2FuYXJ5\x07\x1b[2J = "\x1b[31m"\n'
    yield "long line", good + b"x" * 2_000_000
    end = Path(NAMES[kind]).suffix
    if end == ".toml":
        for title, text in (
            ("deep", "a = " + "[" * 100_000), ("dotted", ".".join("a" * 50_000) + " = 1"),
            ("tables", "[a]\n" * 50_000), ("number", "a = " + "9" * 100_000), ("power", 'a = "1 m**9**9**9"'),
            ("time", "a = 9999-12-31T23:59:60.999999999999+23:59"), ("key", f"\"{'k' * 200_000}\" = 1"),
            ("escaped", 'name = "\\u001b[31m\\u202e\\u0000=cmd|calc"'),
        ):  # fmt: skip
            yield title, text.encode()
            yield f"{title} behind a good one", good + b"\n" + text.encode()
    elif end == ".json":
        for title, text in (
            ("deep", "[" * 100_000), ("number", '{"format": ' + "9" * 100_000 + "}"), ("infinite", '{"format": 1e999}'),
            ("object", '{"py/object": "canary_module.Canary"}'), ("twice", '{"format": "a", "format": "b"}'),
            ("text", '{"format": "\\u001b]0;x\\u0007"}'),
        ):  # fmt: skip
            yield title, text.encode()
    elif end == ".csv":
        for title, text in (
            ("formula", "=cmd|' /C calc'!A1,t [s]\n1,2\n"), ("columns", "a," * 200_000),
            ("open quote", 'a,b\n"' + "x\n" * 99_999),
            ("number", "t [s]\n" + "9" * 400 + "\n"), ("nothing", "\n" * 100_000),
        ):  # fmt: skip
            yield title, text.encode()


def _make_zip_bomb() -> bytes:
    """An archive whose member is a gigabyte by what its name says, and whose name leads out of a folder."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("../../../outside/canary_module.py", bytes(16 << 20))
        archive.writestr(
            "t.npy", b"\x93NUMPY\x01\x00v\x00{'descr': '|O', 'fortran_order': False, 'shape': (9999999999,)}"
        )
    return file.getvalue()


def _make_bomb(kind: str) -> bytes:
    """One chunk of a recording that says it is short and is long."""
    whole = bytes(64 << 20)
    packed = zstandard.compress(whole) if kind == "zstd" else lz4.frame.compress(whole)
    name = kind.encode()
    head = struct.pack("<QQQII", 0, 1, 64, 0, len(name)) + name + struct.pack("<Q", len(packed))
    return b"\x06" + struct.pack("<Q", len(head) + len(packed)) + head + packed


def _craft_scenes(canary: str) -> Iterator[tuple[str, str, str, bytes]]:
    """Entities, plugins, and numbers that are asked of the compiler."""
    laughs = "".join(f"<!ENTITY l{n} '{f'&l{n - 1};' * 10}'>" for n in range(1, 10))
    for title, text in (
        ("laughs", f"<!DOCTYPE mujoco [<!ENTITY l0 'ha'>{laughs}]><mujoco>&l9;</mujoco>"),
        ("entity", f"<!DOCTYPE mujoco [<!ENTITY x SYSTEM 'file://{canary}.xml'>]><mujoco model='&x;'/>"),
        ("doctype", f"<!DOCTYPE mujoco SYSTEM '{canary}.xml'><mujoco/>"),
        ("plugin", "<mujoco><extension><plugin plugin='mujoco.pid'/></extension></mujoco>"),
        (
            "library",
            f"<mujoco><compiler meshdir='{canary}' assetdir='/'/><asset><mesh file='canary.obj'/></asset></mujoco>",
        ),
        ("timestep", "<mujoco><option timestep='1e-300'/><worldbody/></mujoco>"),
        ("not a number", "<mujoco><worldbody><body><freejoint/><geom size='nan'/></body></worldbody></mujoco>"),
        ("names", f"<mujoco model='{'x' * 300_000}'><worldbody/></mujoco>"),
        ("include itself", "<mujoco><include file='crafted.xml'/></mujoco>"),
        ("keyframes", "<mujoco><keyframe>" + "<key/>" * 50_000 + "</keyframe><worldbody/></mujoco>"),
    ):  # fmt: skip
        yield f"scene {title}", COMMANDS[K.SCENE][0], "crafted.xml", text.encode()


class _Payload:
    def __reduce__(self) -> tuple[Any, ...]:
        return __import__, ("canary_module",)


def _craft_recordings() -> Iterator[tuple[str, str, str, bytes]]:
    import numpy as np

    from haptorb.recording.mcap import Recorder
    from haptorb.recording.row import RowLayout

    pickled = pickle.dumps(_Payload()).hex()
    worlds: list[tuple[str, dict[str, str]]] = [
        ("world", {"tick": "0", "change": "1", "world": json.dumps(world)})
        for world in (
            {"name": "canary", "file": "canary_module.py", "loaded": "yes", "digest": "0" * 64},
            {"name": "canary", "file": "canary_module.py:Canary", "module": "canary_module"},
            {"name": "../../canary", "memory": [{"name": "../..", "unit": "m", "shape": [3]}]},
            {"name": "dome", "values": {"moment": "9" * 400}},
            {"name": "scene-x", "scene": "/dev/zero", "body": "peg"},
            {"py/object": "canary_module.Canary", "pickle": pickled},
        )
    ] + [("state", {"tick": "0", "state": pickled}), ("states", {"pickle": pickled, "format": "pickle"})]
    layout = RowLayout(3, 9, memory=4)
    for number, note in enumerate(worlds):
        file = io.BytesIO()
        recorder = Recorder(file, layout, 1000.0, 10**18)
        recorder.add_metadata("device", {"name": "omni", "digest": "0" * 64, "files": "/dev/zero"})
        recorder.add_metadata("run", {"driver": "sim", "model": "canary_module", "rate_hz": "1000"})
        recorder.add_metadata(*note)
        recorder.append(np.zeros((20, layout.width)))
        recorder.finish()
        for command in COMMANDS[K.RECORDING]:
            yield f"recording {number}", command, "crafted.mcap", file.getvalue()


#: in place of a note of a recording, and of the values in those that are JSON
_NOTES = (
    "", "0", "-1", "1e999", "nan", "9" * 5000, "null", "true", "[]", "{}", '{"x": [1]}', "[[[1]]]", "[" * 5000,
    '{"a":' * 300 + "1" + "}" * 300, "\x1b[2J", "x" * 100_000, "../../../etc/passwd", "/dev/zero", "%%%", "AAAA",
)  # fmt: skip


_VALUES = (None, True, 1e300, [], {}, [[1]], "x", -1, {"a": {}})


def _craft_notes(good: bytes, canary: str) -> Iterator[tuple[str, str, str, bytes]]:
    """A recording whose frame and rows are right, and of whose notes one says something else."""
    import numpy as np

    from haptorb.recording.mcap import Recorder
    from haptorb.recording.recording import Recording
    from haptorb.worlds import PathGuidance
    from haptorb.worlds.user_world import note_world

    with tempfile.NamedTemporaryFile(suffix=".mcap") as file:
        file.write(good)
        file.flush()
        whole = Recording(file.name)

    def write(changed: int, key: str, value: str) -> bytes:
        made = io.BytesIO()
        recorder = Recorder(made, whole.layout, 1000.0, 0)
        for number, (name, values) in enumerate(whole.notes):
            short = name.removeprefix("haptorb/")
            if number == changed:
                recorder.add_metadata(short, {**values, key: value})
            elif short not in ("layout", "clock"):
                recorder.add_metadata(short, values)
        recorder.append(np.array(whole.rows))
        recorder.finish()
        return made.getvalue()

    path, chance = json.loads(note_world(PathGuidance())), random.Random(35)
    for number, (name, values) in enumerate(whole.notes):
        for key, text in values.items():
            others = chance.sample(_NOTES, 3)
            if text.startswith("{"):
                known = json.loads(text)
                others += [json.dumps({**known, inner: one}) for inner in known for one in chance.sample(_VALUES, 2)]
            for other in others:
                command = chance.choice(
                    ("replay FILE", "replay FILE", "info FILE --json", "export FILE -o out.csv --force")
                )
                content = write(number, key, other)
                yield f"note {name} {key} {other[-60:]!a}", command, "crafted.mcap", content
    run = next(n for n, (name, _) in enumerate(whole.notes) if name == "haptorb/run")
    named = json.loads(whole.notes[run][1]["first_world"])["name"]
    digest = "0" * 64
    for made in (
        {"made": {"kind": "haptorb.worlds.scene:Scene", "fields": {"source": f"{canary}.xml"}}},
        {"made": {"kind": "haptorb.worlds.scene:Scene",
                  "fields": {"source": {"scene": f"{canary}.xml", "digest": digest}}}},
        {"made": {"kind": "haptorb.worlds.user_world:WorldFile", "fields": {"path": f"{canary}_module.py"}}},
        {"code": {"file": f"{canary}_module.py", "name": "Canary", "digest": digest, "loaded": "yes", "made": ""}},
        {"code": {"file": "/dev/zero", "name": "Canary", "digest": digest, "loaded": "yes", "made": ""}},
        {**path, "made": {**path["made"], "fields": {"path": {"kind": "haptorb.worlds.path:GuidancePath", "fields": {
            "places": {"array": "", "dtype": "<f8", "shape": [0, 3]}, "tangents": None, "spacing": 1e-12,
            "closed": False}}}}},
    ):  # fmt: skip
        content = write(run, "worlds", json.dumps({named: json.dumps(made)}))
        yield f"world {str(made)[:60]}", "replay FILE", "crafted.mcap", content


def _craft_databases(inside: Path) -> Iterator[tuple[str, str, str, bytes]]:
    for name, kind in ((NAMES[K.STUDY_DATABASE], K.STUDY_DATABASE), (NAMES[K.RESULTS], K.RESULTS)):
        for number, statement in enumerate((
            "CREATE VIEW v AS WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x FROM c) SELECT x FROM c",
            "CREATE TRIGGER t AFTER INSERT ON %s BEGIN SELECT load_extension('/tmp/x'); END",
            "CREATE VIRTUAL TABLE v USING fts5(a)",
            "ALTER TABLE %s ADD COLUMN bomb AS (hex(zeroblob(900000000)))",
            "DROP TABLE %s",
        )):  # fmt: skip
            copy = inside / "crafted.db"
            shutil.copy(inside / name, copy)
            with contextlib.closing(sqlite3.connect(copy, isolation_level=None)) as found:
                found.execute("PRAGMA journal_mode = DELETE")
                found.execute(statement.replace("%s", "trials" if kind is K.STUDY_DATABASE else "runs"))
            content = copy.read_bytes()
            copy.unlink()
            for command in COMMANDS[kind]:
                yield f"{kind.name} {number}", command, "crafted.db", content
