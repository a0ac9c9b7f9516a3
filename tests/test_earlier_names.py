"""Names of version 0.1: imports that its documents teach, fields, and the place of the remark.

A remark must be seen by default, so all of them are used in one other process with Python's own filters.
"""

from __future__ import annotations

import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

from haptorb.cli import main
from haptorb.earlier_names import EARLIER, EarlierNameWarning, find_module
from haptorb.worlds.user_world import WorldFile

#: every import from haptorb in README, docs and examples of commit 5e5cc684: module, names
DOCUMENTED = """
haptorb Recording Servo
haptorb.apps feel
haptorb.apps.inspect.errors report_errors
haptorb.apps.study.analysis.load_analysis analysis_of
haptorb.control.stability.hand_grip GRIPS
haptorb.control.stability.stability SampledLoop
haptorb.design.design_file parse_design
haptorb.design.sampling sample sweep
haptorb.design.store open_results read_results
haptorb.design.workers.open_workers open_workers
haptorb.devices.electromagnet.shell_capability shell_capability
haptorb.devices.kind DeviceKind
haptorb.devices.loader parse
haptorb.devices.state State
haptorb.errors DriverError
haptorb.numerics.arrays vectors
haptorb.physics.interaction wrench
haptorb.physics.sources.dipole field field_gradient
haptorb.physics.sources.placement PlacedSource
haptorb.physics.sources.ring RingMagnet
haptorb.physics.sources.source Source
haptorb.runtime.drivers.driver Driver
haptorb.runtime.replay.replay Replay
haptorb.runtime.trackers.feed Feed RawPose
haptorb.sensing.estimator Estimator TrackedPose
haptorb.sensing.sample Pose Sample
haptorb.worlds Dome DynamicWorld MemoryField Outlet PathGuidance Scene Shape World make_path
haptorb.worlds.parameter parameter
"""
#: of these, the one that needs another program today, and what the error names
GONE = {"from haptorb.devices.kind import DeviceKind": "haptorb.kinds"}
OLDER = Path(__file__).parent / "contracts" / "older" / "omni.mcap"
WORLD = """
import numpy as np
from dataclasses import dataclass
from haptorb.worlds import World
from haptorb.worlds.parameter import parameter

@dataclass(frozen=True)
class Groove(World):
    stiffness: float = parameter(40.0, "N/m", 0, 100, "of the spring")

    def wrench(self, state):
        return np.zeros(6)
"""
#: executes the lines that it reads as a user's program, each at its own line; prints what was lost of an import
USER = """
import sys
for number, line in enumerate(sys.stdin.read().splitlines(), 1):
    try:
        exec(compile(chr(10) * (number - 1) + line, "users.py", "exec"))
    except ImportError as cause:
        print(line, cause, sep="|")
print("then", *[name for name in ("numpy", "numba", "haptorb.estimation", "haptorb_design") if name in sys.modules])
"""


def list_imports() -> list[str]:
    """Lines, one for each name."""
    rows = [line.split() for line in DOCUMENTED.split("\n") if line]
    return [f"from {module} import {name}" for module, *names in rows for name in names]


def run_lines(lines: list[str], folder: Path) -> tuple[str, dict[str, list[str]]]:
    """What a process prints that executes `lines` in `folder`, and line → the remarks at it."""
    done = subprocess.run(
        [sys.executable, "-c", USER], input="\n".join(lines), cwd=folder, capture_output=True, text=True, check=True
    )
    remarks: dict[str, list[str]] = {line: [] for line in lines}
    for line in done.stderr.splitlines():
        place, _, text = line.partition(": EarlierNameWarning: ")
        if text:
            file, _, number = place.rpartition(":")
            assert file == "users.py", line
            remarks[lines[int(number) - 1]].append(text)
    return done.stdout, remarks


def test_every_documented_import_works_with_one_remark(tmp_path: Path) -> None:
    """Also where a folder of that name lies in the working directory, which a program started by `-c` searches."""
    for folder in ("haptorb/sensing", "sensing"):
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / "estimator.py").write_text("raise SystemExit('from the working directory')\n")
    (tmp_path / "haptorb/parameter.py").write_text("raise SystemExit('from the working directory')\n")
    imports = list_imports()
    fields = [
        "import haptorb, warnings; warnings.simplefilter('ignore', haptorb.RecordingWarning)",
        f"recording = haptorb.Recording({str(OLDER)!r})",
        "recording['asked']",
        "recording.read(0, 2, ['asked'])",
        "from haptorb.recording.row import LatestRow, RowLayout; layout = RowLayout(3, 0)",
        "row = LatestRow(layout, layout.empty()); row.p",
        "row.asked",
        "row['asked']",
        "layout['asked']",
        "haptorb.felt_map",
        "from haptorb.worlds import parameter; parameter(1.0, 'N', 0, 2, 'public function')",
    ]
    # the first `import haptorb` must come from its package, not from the folder
    lines = [f"import sys; sys.path.remove(''); import haptorb; sys.path.insert(0, {str(tmp_path)!r})"]
    printed, remarks = run_lines([*lines, *imports, *fields], tmp_path)
    lost = dict(line.split("|") for line in printed.splitlines() if "|" in line)
    assert set(lost) == set(GONE)
    for line, use in GONE.items():
        assert use in lost[line]
    for line in imports:
        _, module, _, name = line.split()
        now = EARLIER.get(f"{module}:{name}") or EARLIER.get(f"{module}.{name}") or EARLIER.get(module, "")
        earlier = bool(now) and line not in GONE
        assert len(remarks[line]) == earlier, line
        assert not earlier or now.partition(":")[0] in remarks[line][0]
    assert {line for line in fields if len(remarks[line]) == 1} == {
        "recording['asked']", "recording.read(0, 2, ['asked'])", "row.asked", "row['asked']", "layout['asked']",
        "haptorb.felt_map",
    }  # fmt: skip


def test_the_table_leads_to_what_there_is() -> None:
    """Rows without an import in the documents too; a module of worlds is where recordings look for its worlds."""
    for now in EARLIER.values():
        if " " not in now:
            module, _, name = now.partition(":")
            assert not name or hasattr(import_module(module), name), now
            import_module(module)
    assert find_module("haptorb.worlds.dynamic", "Remote") == "haptorb.worlds.client_force"


def test_a_name_that_never_was_is_an_ordinary_error() -> None:
    with pytest.raises(ImportError, match="cannot import name 'nonsense'"):
        exec("from haptorb.sensing.sample import nonsense")
    with pytest.raises(ModuleNotFoundError, match=r"haptorb\.sensing\.nonsense"):
        exec("import haptorb.sensing.nonsense")


def test_a_world_file_of_version_0_1_is_loaded(tmp_path: Path) -> None:
    path = tmp_path / "groove.py"
    path.write_text(WORLD)
    sys.modules["haptorb.worlds.parameter"].__dict__.pop("parameter", None)  # of another test: one remark a process
    with pytest.warns(EarlierNameWarning, match="from haptorb.worlds import parameter") as found:
        world = WorldFile(path).load()
    assert world.name == "groove"
    assert [Path(one.filename) for one in found] == [path]
    assert WorldFile(path).load({path: WORLD}) is not None


@pytest.mark.filterwarnings("default")
def test_a_command_prints_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["export", str(OLDER), "-o", str(tmp_path / "o.csv"), "--fields", "t,asked"])
    assert end.value.code == 0
    errors = capsys.readouterr().err.splitlines()
    assert [line for line in errors if "asked" in line] == ["the field 'asked' is now called 'wrench_commanded'"]
