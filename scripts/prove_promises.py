"""Break the code once per promise of the safety concept and check that its command fails.

    python scripts/prove_promises.py [WORD…] [--list] [--intact]

With words: only the rows in whose text one of them stands. `--list` prints the rows and how each is broken. `--intact`
breaks nothing: it runs every command of the table once, as it is written there (`make nightly`).

Every row of the table in docs/explanation/safety.md names a command that demonstrates a promise. A command that stays
green while the rule behind it is broken demonstrates nothing. Each line of BREAKS names a row, one of its commands
(with arguments that shorten it, if any), and the statement that is broken: a marker `# safety: NAME`, broken as
`prove_safety.py` does, or a replacement of text in a file that is no Python. The change is made in a copy of the tree.
The command must succeed in the unchanged copy and fail in the changed one.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from functools import cache
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from prove_safety import RULES
from safety_markers import MarkerError, break_code, find_marked

ROOT = Path(__file__).resolve().parent.parent
TABLE = ROOT / "docs" / "explanation" / "safety.md"
TIMEOUT = 1800.0  #: of one command [s]
#: the same for each unit of an option of commands that take longer [s]
TIMEOUTS = {"--ends": 20.0}
#: commands that are not proved, with the reason
NOT_PROVED = {
    "haptorb hardware probe": "only a real device answers it",
    "haptorb bench tick loop": "it measures; what is slow is no broken rule",
}


@dataclass(frozen=True)
class Text:
    """A change of a file that is no Python: one occurrence of `old` becomes `new`."""

    file: str
    old: str
    new: str


@dataclass(frozen=True)
class Break:
    """One way to break one promise, and the command that must notice it.

    row       the beginning of the promise in the table
    command   one of the row's commands
    change    a marker in the Python sources, or a Text
    quick     arguments that are added to shorten the command
    """

    row: str
    command: str
    change: str | Text
    quick: str = ""


INTERLEAVINGS = "python tests/fuzz/stop_interleavings.py"
TICK = "pytest tests/runtime/tick/test_tick.py"
HOSTILE_WORLDS = "python tests/fuzz/hostile_worlds.py"
#: of hostile_worlds: only a world that blocks all signals
BLOCKING_SIGNALS = '--worlds "blocks all signals" --crashes 0 --stops 0 --busy 0'
I2C_FAULTS = "python benchmarks/safety/i2c_faults.py"
HOSTILE_WEB = "python tests/fuzz/hostile_web.py"
TICK_PERIODS = "python benchmarks/safety/tick_periods.py"
STUDY_STOP = "python benchmarks/safety/study_stop.py"

BREAKS = (
    Break("Every end of a run", "python benchmarks/safety/ends.py --ends 1000", "stop-first", "--ends 7 --boards sim"),
    Break(
        "Every end of a run",
        "python benchmarks/safety/ends.py --ends 1000",
        "output-queued",
        "--ends 7 --boards sim --faults terminal",
    ),
    Break("A terminal or pager", "pytest tests/runtime/servo/test_ends.py -k not_read", "output-queued"),
    Break("A servo in an event loop", "pytest tests/runtime/servo/test_async.py", "async-stop-first"),
    Break("SIGINT, SIGTERM, SIGHUP and SIGQUIT", "pytest tests/runtime/servo/test_ends.py", "signal-read", "-k middle"),
    Break("A servo that was opened", "pytest tests/runtime/servo/test_ends.py -k main_thread", "main-ended"),
    Break("A loop that was absent", "pytest tests/runtime/servo/test_ends.py -k stopped_for_a_second", "absence-trips"),
    *(
        Break("A child process runs nothing", "pytest tests/test_child_process.py", change)
        for change in (
            "no-current-folder",
            "isolated-child",
            "folders-last",
            "spawned-without-folder",
            "no-local-numba-settings",
            "no-local-matplotlibrc",
        )
    ),
    *(
        Break(
            "A server, recorder or servo",
            'pytest tests/runtime/servo/test_ends.py -k "hangs_while or full"',
            change,
        )
        for change in ("start-hangs", "start-sends-beside")
    ),
    Break("After a Stop the coils stay off", INTERLEAVINGS, "engage-void", "--interleavings 2000"),
    Break("Every transition from off to on", INTERLEAVINGS, "engaging-ramps-from-zero", "--interleavings 500"),
    Break("The tracker cannot clear a Stop", TICK, "a-stop-before-the-first-pose-stands"),
    Break("A Stop before or during the start", "pytest tests/runtime/servo/test_servo.py -k stop", "start-stop"),
    Break("Console: a Stop from any page", "pytest tests/web/console/test_socket_hub.py -k stop", "console-stop-first"),
    Break(
        "Console: a page that hangs",
        "pytest tests/web/console/test_pointer_relay.py tests/browser/test_console_drag.py",
        "pointer-bridged",
    ),
    Break("Console: a page that hangs", "pytest -m slow tests/browser/test_console_drag.py", "stale-poses-trip"),
    Break("Study: a Stop from any page", STUDY_STOP, "study-stop-first", "--states running --repetitions 1 --lock 3"),
    *(
        Break(
            "Study: real data, pilots and simulated",
            "pytest tests/study/database/test_contents.py tests/study/database/test_merge.py",
            change,
        )
        for change in ("study-one-kind", "study-merge-kind")
    ),
    Break("Study: a person who withdraws", "pytest tests/study/database/test_merge.py -k withdraw", "study-withdrawn"),
    Break("Study: after a malformed message", "pytest tests/study/test_stop.py", "study-fault"),
    Break(
        "No winding is hotter",
        "python benchmarks/safety/coupled_heat.py",
        "coils-warm-each-other",
        "--devices 2 --minutes 4",
    ),
    *(
        Break("The coils never take more", "python benchmarks/safety/supply_power.py", change, "--wrenches 20000")
        for change in (
            "supply-power-is-kept",
            "supply-power-of-forces",
            "supply-power-of-motors",
            "supply-power-of-wrenches",
        )
    ),
    Break(
        "Torque is limited",
        "pytest tests/runtime/tick/test_rendered_part.py tests/control/allocation/test_whole_wrench.py",
        "damping-brakes-turns",
    ),
    Break(
        "Torque is limited",
        "pytest tests/runtime/tick/test_rendered_part.py tests/control/allocation/test_whole_wrench.py",
        "accompanying-force-is-limited",
    ),
    Break("Heat, slew, ramps and expiry", TICK_PERIODS, "windings-heat-by-the-clock", "--seconds 20"),
    Break("A loop that misses more", TICK_PERIODS, "missed-deadlines-trip", "--seconds 5"),
    Break(
        "The coils of a silent loop go off",
        "pytest -m slow tests/firmware/test_coils_off.py",
        Text("firmware/core/guard.c", "if (++guard->silence >= SILENCE_MS) {", "if (guard->silence > SILENCE_MS) {"),
    ),
    Break("The coils of a silent loop go off", TICK, "simulated-watchdog"),
    Break(
        "A current sensor that reads 0",
        "python benchmarks/safety/current_faults.py",
        "current-mismatch-trips",
        "--hours 0.01 --faults 20",
    ),
    Break("No false trip", "python benchmarks/safety/false_trips.py", "host-computing", "--minutes 0.5"),
    Break("A world that does not return", HOSTILE_WORLDS, "world-hung", BLOCKING_SIGNALS),
    Break(
        "A servo does not outlive its host",
        HOSTILE_WORLDS,
        "servo-hung",
        BLOCKING_SIGNALS,
    ),
    Break(
        "The coils of a stopped host",
        f"{HOSTILE_WORLDS} --stops 20",
        "host-stopped",
        "--worlds --crashes 0 --stops 3 --busy 0",
    ),
    Break(
        "Nothing that dead programs left",
        f"{HOSTILE_WORLDS} --crashes 100",
        "leftovers-swept",
        "--worlds --crashes 4 --stops 0 --busy 0",
    ),
    Break(
        "A recorder that does not respond",
        "pytest tests/runtime/test_stalled_recorder.py",
        "recorder-stalled",
    ),
    Break(
        "A repaired recording never replaces",
        "pytest tests/recording/test_damaged_recordings.py -k repaired",
        "repair-keeps-input",
    ),
    *(
        Break(
            "The coil state is what the device confirmed",
            "pytest tests/contracts/test_drivers.py tests/runtime/drivers/serial/test_serial_driver.py "
            "tests/runtime/drivers/i2c/test_i2c_faults.py",
            change,
            "-k 'state or off'",
        )
        for change in ("serial-unknown", "i2c-off-unsaid")
    ),
    Break("I²C: after a bus fault", I2C_FAULTS, "i2c-obeyed", "--faults 60 --guardians 0"),
    Break("I²C: a stopped or dead guardian", I2C_FAULTS, "guardian-silent", "--faults 1 --guardians 3"),
    Break(
        "I²C: coils off when host and guardian both stop",
        "pytest tests/runtime/drivers/i2c/test_i2c_faults.py",
        "i2c-monostable",
    ),
    Break("I²C: one program per PWM chip", "pytest tests/runtime/drivers/i2c/test_i2c_lock.py", "i2c-lock"),
    Break(
        "Firmware: no engaging while a coil is hot",
        "make -C firmware test",
        Text("firmware/core/bridge.c", "return REFUSED_HOT;", "continue;"),
    ),
    Break(
        "Firmware: a calibration reported as stored",
        "python benchmarks/safety/store_resets.py",
        Text(
            "firmware/core/calibration.c",
            "calibration->state = CALIBRATION_WRITING;\n    return REFUSED_WRITING;",
            "calibration->state = CALIBRATION_WRITING;\n    return ACCEPTED;",
        ),
    ),
    Break(
        "A world declared passive", "pytest tests/analysis/stability/test_wall.py", "lasting-oscillation-is-softened"
    ),
    *(
        Break("What changes who commands", "python benchmarks/safety/client_forces.py", change, "--events 2000")
        for change in ("client-force-rate", "clients-pass-zero")
    ),
    Break(
        "What changes who commands",
        "python benchmarks/safety/client_forces.py",
        "clients-flow-at-their-rate",
        "--events 5000",
    ),
    Break("What changes who commands", "pytest tests/runtime/tick/test_tick.py -k another_world", "another-of-a-class"),
    Break("Only the client that holds", "pytest tests/serve/test_handover.py", "holder-maps"),
    Break(
        "A program for Force Dimension's",
        "python benchmarks/connections/native_programs.py kills",
        "native-exit-told",
        "--kills 4",
    ),
    *(
        Break("A program for Force Dimension's", "pytest tests/serve/native/test_server.py -k regulation", change)
        for change in (
            Text("native/dhd/drd.c", "r->extra_at > ALONE_NS", "r->extra_at > INT64_MAX - 1"),
            Text("native/dhd/drd.c", "const bool drives = known &&", "const bool drives = known ||"),
        )
    ),
    *(
        Break("Torque and gripper force of a program", "pytest tests/runtime/tick/test_client_force.py", change)
        for change in ("client-torque-rate", "client-fades-from-limit", "gripper-off-in-silence")
    ),
    *(
        Break("Through these libraries one program", "pytest tests/serve/native/test_server.py", change)
        for change in (
            "native-own-commands-only",
            Text("native/link/link.c", "} else if (!finite) {", "} else if (false) {"),
            Text("native/link/link.c", "links[i].forked = links[i].open;", "links[i].forked = false;"),
        )
    ),
    Break(
        "Another account of the computer can neither",
        HOSTILE_WEB,
        "console-token",
        "--connections 20 --seconds 2",
    ),
    Break("With `--host`", "pytest tests/web/test_page_for_others.py", "console-token"),
    *(
        Break(
            "Another account of the computer moves",
            "python benchmarks/safety/other_accounts.py",
            change,
            "--attempts 98",
        )
        for change in (
            "serve-account",
            "osc-token",
            "osc-port-of-account",
            "tracker-account",
            "secret-by-pipe",
            "study-token",
            "report-token",
        )
    ),
    Break("A database's password", "pytest tests/cli/test_passwords.py", "no-password-in-words"),
    Break("Hostile connections take neither", HOSTILE_WEB, "few-connections", "--connections 400 --seconds 6"),
    Break(
        "No web message ends a task",
        "pytest -m slow tests/web/server/test_hostile_messages.py",
        "web-message",
        "-k refused",
    ),
    *(
        Break("No compiled kernel, plan", "pytest tests/test_cache_folder.py", change)
        for change in ("cache-private", "private-temporary")
    ),
    Break(
        "What is opened runs no code",
        "pytest tests/worlds/user_world/test_started_code.py tests/contracts/test_foreign_recordings.py",
        "recordings-run-no-code",
    ),
    Break("A recording contains numbers", "pytest tests/replay/test_bad_recordings.py", "state-types"),
    Break("Code of a file is named", "pytest tests/cli/test_own_code.py", "code-is-announced"),
    Break("One sender per OSC tracker", "python scripts/prove_safety.py jump sender", "one-sender"),
    Break("Text of a file does nothing", "pytest tests/contracts/test_poisoned_files.py", "text-visible", "-k info"),
    Break("A file of another kind", "pytest tests/contracts/test_file_kinds.py", "kind-told", "-k info"),
    *(
        Break("A database computes nothing", "pytest tests/contracts/test_strangers_databases.py", change, quick)
        for change, quick in (
            ("database-schema", "-k schema"),
            ("database-link", "-k test_files_beside"),
            ("database-journal", "-k test_files_beside"),
            ("database-lock", "-k lock_file"),
        )
    ),
    *(
        Break("A scene reads files of its own", "pytest tests/worlds/scene/test_strangers_scenes.py", change)
        for change in (
            "named-inside",
            "plain-names",
            "compiler-opens-nothing",
            "scene-elements",
            "compile-time",
            "compile-memory",
            "compiled-apart",
        )
    ),
    Break(
        "A file is read, or rejected",
        "python tests/fuzz/hostile_files.py",
        "named-inside",
        "--only crafted --mutants 0",
    ),
)


def read_promises(page: str) -> dict[str, list[str]]:
    """Promise → the commands of its row, of every row that names one."""
    found = {}
    for line in page.split("\n## What is promised")[1].split("\n## ")[0].splitlines():
        cells = [cell.strip() for cell in line.strip().strip("|").split("|")]
        if len(cells) == 4 and (commands := re.findall(r"`([^`]+)`", cells[2])):
            found[cells[0]] = commands
    return found


def find_gaps(promises: dict[str, list[str]], breaks: tuple[Break, ...]) -> list[str]:
    """What is missing: rows without a break, commands that no break runs, breaks without a row."""
    gaps = []
    for promise, commands in promises.items():
        own = {one.command for one in breaks if promise.startswith(one.row)}
        gaps += [
            f"no break makes `{command}` fail: {promise}"
            for command in commands
            if command not in own and command not in NOT_PROVED
        ]
    for one in breaks:
        rows = [commands for promise, commands in promises.items() if promise.startswith(one.row)]
        if len(rows) != 1:
            gaps.append(f"{len(rows)} rows begin with '{one.row}'")
        elif one.command not in rows[0]:
            gaps.append(f"the row '{one.row}' does not name `{one.command}`")
    return gaps


_find_marked = cache(find_marked)  # the sources are as before after each break


def break_code_of(tree: Path, change: str | Text) -> tuple[Path, str]:
    """The file of the copy `tree` that `change` is made in, and its text after that. MarkerError if it fits nothing."""
    if isinstance(change, Text):
        path = tree / change.file
        text = path.read_text(encoding="utf-8")
        if text.count(change.old) != 1:
            raise MarkerError(f"'{change.old}' must stand once in {change.file}, not {text.count(change.old)} times")
        return path, text.replace(change.old, change.new)
    mutations = {marker: mutation for marker, _, mutation, _ in RULES}
    marked = _find_marked(tree / "src")
    if change not in marked or change not in mutations:
        raise MarkerError(f"'{change}' is no marker in the sources, or has no rule in scripts/prove_safety.py")
    return marked[change].path, break_code(marked[change], mutations[change])


def copy_tree(folder: Path) -> Path:
    """The files of the project in `folder`, built pages and firmware included."""
    left_out = shutil.ignore_patterns(
        ".git", ".venv", "node_modules", "__pycache__", "*_cache", ".hypothesis", "_build"
    )
    return Path(shutil.copytree(ROOT, folder / "tree", ignore=left_out))


def find_timeout(command: str) -> float:
    """Longest time of `command` [s]."""
    words = shlex.split(command)
    counts = {name: float(words[words.index(name) + 1]) for name in TIMEOUTS if name in words}
    return max([TIMEOUT, *(TIMEOUTS[name] * count for name, count in counts.items())])


def run_command(command: str, tree: Path, *, retry: bool = True) -> tuple[bool, str]:
    """Whether `command` succeeds in `tree`, and the end of what it printed; `retry` tests beside a clock, as usual."""
    words = shlex.split(command)
    if words[0] == "pytest":
        words = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", "-o", "timeout=1500", *words[1:]]
        words += [] if retry else ["-p", "no:rerunfailures"]
    elif words[0] in ("python", "haptorb"):
        words = [sys.executable, *(["-m", "haptorb"] if words[0] == "haptorb" else []), *words[1:]]
    environment = {**os.environ, "PYTHONPATH": str(tree / "src"), "XDG_CACHE_HOME": str(tree.parent / "cache")}
    environment.pop("NUMBA_CACHE_DIR", None)
    timeout = find_timeout(command)
    try:
        run = subprocess.run(
            words, cwd=tree, env=environment, capture_output=True, text=True, timeout=timeout, check=False
        )
    except subprocess.TimeoutExpired:
        return False, f"did not end within {timeout:g} s"
    said = (run.stdout + run.stderr)[-1500:]
    if "pytest" in words and run.returncode not in (0, 1):
        raise SystemExit(f"{command}: pytest could not run its tests\n{said}")
    return run.returncode == 0, said


def prove(one: Break, tree: Path, intact: dict[str, tuple[bool, str]]) -> str:
    """An empty text if the command succeeds as the code is and fails when it is broken; else what it did."""
    command = f"{one.command} {one.quick}".strip()
    if command not in intact:
        intact[command] = run_command(command, tree)
    if not intact[command][0]:
        return f"FAILS ANYWAY\n{intact[command][1]}"
    path, broken = break_code_of(tree, one.change)
    whole = path.read_text(encoding="utf-8")
    path.write_text(broken, encoding="utf-8")
    try:
        succeeds, _ = run_command(command, tree, retry=False)
    finally:
        path.write_text(whole, encoding="utf-8")
    return "STAYS GREEN" if succeeds else ""


def run_all(promises: dict[str, list[str]], words: list[str]) -> int:
    """Run every command of the chosen rows once, where the code is as it is; 1 if one fails."""
    chosen = {
        command: promise
        for promise, commands in promises.items()
        for command in commands
        if command not in NOT_PROVED and (not words or any(word.lower() in promise.lower() for word in words))
    }
    failed = 0
    for command, promise in chosen.items():
        begun = time.monotonic()
        succeeds, output = run_command(command, ROOT)
        failed += not succeeds
        seconds = time.monotonic() - begun
        print(f"{'kept' if succeeds else 'NOT kept'} ({seconds:.0f} s): {promise}: {command}", flush=True)
        print("\n".join(f"    {line}" for line in output.splitlines()[-4 if succeeds else -30 :]), flush=True)
    print(f"{len(chosen) - failed} of {len(chosen)} commands show that their promises are kept")
    return int(failed > 0)


def main() -> int:
    """Prove every chosen row; the exit code is 1 unless every command fails where its promise is broken."""
    # A shell has what it starts in the background ignore Ctrl-C, and so would the programs that commands end by it.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    words = [word for word in sys.argv[1:] if word not in ("--list", "--intact")]
    promises = read_promises(TABLE.read_text(encoding="utf-8"))
    if "--intact" in sys.argv:
        return run_all(promises, words)
    gaps = find_gaps(promises, BREAKS)
    chosen = [
        one
        for one in BREAKS
        if not words or any(word.lower() in f"{one.row} {one.command} {one.change}".lower() for word in words)
    ]
    if "--list" in sys.argv:
        for one in chosen:
            print(f"{one.row}: {one.command} {one.quick}; broken: {one.change}")
        return 0
    failed = 0
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        tree, intact = copy_tree(Path(folder)), dict[str, tuple[bool, str]]()
        for one in chosen:
            fault = prove(one, tree, intact)
            failed += bool(fault)
            print(
                f"{fault.splitlines()[0] if fault else 'red when broken':>16}  {one.row} ({one.change}): {one.command}",
                flush=True,
            )
            print(
                "\n".join(f"    {line}" for line in fault.splitlines()[1:]),
                end="\n" if "\n" in fault else "",
                flush=True,
            )
    print("\n".join([*gaps, f"{len(chosen) - failed} of {len(chosen)} commands fail when their promise is broken"]))
    return 1 if failed or gaps else 0


if __name__ == "__main__":
    sys.exit(main())
