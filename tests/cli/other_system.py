"""Emulates another operating system: `python other_system.py win32 FOLDER` hides what only Linux has.

Then it uses what needs no Linux, and prints one JSON object: name of each part, and what it came to. The processes that
it starts are of that system, too: `python other_system.py win32 -m MODULE ARGUMENTS`, or `-f FILE.py ARGUMENTS`.
"""

import ctypes
import io
import json
import mmap
import os
import pkgutil
import re
import runpy
import select
import selectors
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import traceback
import urllib.request
import warnings
from contextlib import redirect_stderr, redirect_stdout
from functools import partial, partialmethod
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import threadpoolctl

#: other people's modules are loaded first, with all that they take from the system
PACKAGES = """
numpy.ma numpy.polynomial scipy.spatial.transform scipy.special scipy.optimize scipy.integrate scipy.linalg scipy.fft
scipy.interpolate numba llvmlite.binding matplotlib.figure matplotlib.backends.backend_agg
matplotlib.backends.backend_svg pydantic pint rich.console rich.table rich.progress rich.live rich.panel rich.status
typer.testing sqlalchemy sqlite3 sqlalchemy.dialects.sqlite starlette.applications starlette.websockets uvicorn
websockets asyncio asyncio.subprocess uvicorn.protocols.http.h11_impl
uvicorn.protocols.websockets.websockets_sansio_impl mcap.writer mcap.stream_reader zstandard cloudpickle PIL.Image
subprocess tempfile multiprocessing webbrowser csv pickle statistics uuid html difflib importlib.metadata
concurrent.futures.process multiprocessing.popen_spawn_posix multiprocessing.resource_tracker
multiprocessing.connection ipaddress inspect platform shutil getpass
"""

#: those that the processes of a run use
FEW_PACKAGES = """
numpy.ma numpy.polynomial scipy.spatial.transform scipy.special scipy.optimize scipy.integrate scipy.linalg scipy.fft
scipy.interpolate numba llvmlite.binding pydantic asyncio mcap.writer zstandard cloudpickle subprocess tempfile
multiprocessing multiprocessing.popen_fork multiprocessing.popen_spawn_posix multiprocessing.resource_tracker
multiprocessing.connection concurrent.futures.process csv pickle statistics uuid html difflib importlib.metadata
inspect platform shutil getpass ipaddress selectors runpy
"""

#: modules of Linux, attributes of modules that Windows does not have, and folders of Linux
MODULES = "fcntl resource termios tty pty pwd grp syslog posix readline curses smbus2 serial.serialposix"
ATTRIBUTES_OF_WINDOWS = {
    os: r"sched_|posix_|memfd_|pidfd_|eventfd|timerfd|splice|fork|register_at_fork|(get|set)e?[ug]id|(get|set)res|"
    r"(get|set)priority|getloadavg|uname|sysconf|pathconf|fpathconf|p(read|write)v?$|fchmod|fchown|chown|lchown|killpg|"
    r"(get|set)p?[gs]id|set_blocking|get_blocking|pipe2|mkfifo|mknod|statvfs|sendfile|wait[34i]|openpty|ttyname|nice$|"
    r"O_(NONBLOCK|CLOEXEC|NOFOLLOW|DIRECTORY|SYNC|DSYNC|NOCTTY|PATH|TMPFILE)|SCHED_|PRIO_|MFD_|CLONE_",
    signal: r"SIG(KILL|HUP|USR|ALRM|CHLD|STOP|CONT|TSTP|QUIT|RT|XCPU|IO|PIPE)|setitimer|alarm|"
    r"pause|pthread_|sig(wait|pend)",
    select: r"e?poll|EPOLL|POLL",
    socket: r"AF_UNIX|AF_NETLINK|AF_PACKET|SO_REUSEPORT|MSG_(DONTWAIT|NOSIGNAL)|SCM_|send_fds|recv_fds|CMSG_",
    mmap: r"MAP_|PROT_|MADV_",
    time: r"clock_|CLOCK_|pthread_|tzset",
}  # fmt: skip
#: what macOS does not have: it has processes as Linux, but other clocks, schedulers and limits
ATTRIBUTES_OF_MACOS = {
    os: r"sched_|posix_fa|memfd_|pidfd_|eventfd|timerfd|splice|(get|set)res|pipe2|O_(PATH|TMPFILE)|SCHED_|MFD_|CLONE_",
    signal: r"SIGRT|sigtimedwait|sigwaitinfo",
    select: r"epoll|EPOLL",
    socket: r"AF_NETLINK|AF_PACKET|SO_PEERCRED|SO_BINDTODEVICE",
    mmap: r"MAP_POPULATE|MADV_(DONTFORK|HUGEPAGE)",
    time: r"CLOCK_(BOOTTIME|TAI)|pthread_getcpuclockid",
}  # fmt: skip
FOLDERS = re.compile(r"/(proc|sys|dev(?!/(null|u?random)\b)|run)(/|$)")

DESIGNS = """
title = "Door"
world = "snap_fit"

[common]
material = "ABS"
friction = 0.3
width = "6 mm"
thickness = "1.5 mm"
base_length = "15 mm"
peak = "18.5 mm"
height = "1.5 mm"
top = "flat"

[design.easy]
retention = "45 deg"
"""


def hide(system, packages=PACKAGES):
    """From here on this is `system` ("win32"), as far as Python tells; so are the processes that are started."""
    for name in packages.split():
        import_module(name)
    selectors.DefaultSelector = selectors.SelectSelector
    from haptorb.runtime import linux

    # Not sys.platform itself: other people's packages would load another system's parts, late ones too.
    linux.sys = SimpleNamespace(platform=system)
    linux.python_command = lambda module, *arguments, isolated=False: [
        sys.executable, "-P", __file__, system, "-m", module, *arguments
    ]  # fmt: skip
    tempfile._O_TMPFILE_WORKS = False  # it looked for the flag when it was imported
    if system == "win32":
        hide_posix(linux)
    sys.addaudithook(refuse_folders)
    load = ctypes.CDLL.__init__

    def load_library(self, name, *others, **more):
        if name is None:
            raise TypeError("a library has a name")
        load(self, name, *others, **more)

    ctypes.CDLL.__init__ = load_library
    for module, names in (ATTRIBUTES_OF_WINDOWS if system == "win32" else ATTRIBUTES_OF_MACOS).items():
        for name in [name for name in vars(module) if re.match(names, name)]:
            delattr(module, name)
    warnings.filterwarnings("error", category=EncodingWarning, module=r"haptorb\.")  # a file's text has an encoding


def hide_posix(linux):
    """What macOS has and Windows does not."""
    # On Windows a process is spawned without this helper, and there is one way to end it. Here the helper starts before
    # its calls are hidden.
    sys.modules["multiprocessing.resource_tracker"].ensure_running()
    process = sys.modules["multiprocessing.popen_fork"].Popen
    process.kill = process.terminate
    subprocess.Popen.kill = subprocess.Popen.terminate = partialmethod(subprocess.Popen.send_signal, 9)
    for name in MODULES.split():
        sys.modules[name] = None
    # asyncio and threadpoolctl do on each system what is right there
    socket.socketpair = partial(socket.socketpair, socket.AF_UNIX)
    threadpoolctl.ThreadpoolController._find_libraries_with_linux = lambda self: None
    linux._runs_on_windows = runs  # there is no kernel32.dll


def runs(pid):
    """As Windows' kernel tells it."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def refuse_folders(event, values):
    """There is no such folder as /proc."""
    if event in ("open", "os.listdir", "os.scandir") and isinstance(values[0], str) and FOLDERS.match(values[0]):
        raise FileNotFoundError(2, "No such file or directory", values[0])


def import_everything():
    """Modules that could not be imported, and why."""
    failed = {}
    tops = [import_module(name) for name in ("haptorb", "haptorb_study", "haptorb_design")]
    for found in (one for top in tops for one in pkgutil.walk_packages(top.__path__, f"{top.__name__}.")):
        if found.name.endswith("__main__"):
            continue
        try:
            import_module(found.name)
        except Exception as cause:  # whatever it is: the test names it
            failed[found.name] = f"{type(cause).__name__}: {cause}"
    return failed


def run_command(*words):
    """(exit code, what was printed, what was said) of one command."""
    from haptorb.cli import main

    out, err = io.TextIOWrapper(io.BytesIO(), "cp1252", newline=""), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        try:
            code = main([str(word) for word in words])
        except SystemExit as end:
            code = end.code
    out.flush()
    return code, out.buffer.getvalue().decode("cp1252"), err.getvalue()


def run_with_page(*words):
    """As `run_command`, ended by Ctrl-C when its page was read: with how many bytes it answered."""
    from haptorb.cli import main

    out, err, page, ended = io.StringIO(), io.StringIO(), [], threading.Event()

    def read():
        while (found := re.search(r"http://\S+", err.getvalue().replace("\n", " ") + " ")) is None:
            time.sleep(0.02)
        with urllib.request.urlopen(found[0], timeout=20) as answer:
            page.append(len(answer.read()))
        time.sleep(1.0)
        if not ended.is_set():  # by itself, with a message
            signal.raise_signal(signal.SIGINT)

    thread = threading.Thread(target=read, daemon=True)
    thread.start()
    with redirect_stdout(out), redirect_stderr(err):
        try:
            code = main([str(word) for word in words])
        except SystemExit as end:
            code = end.code
        finally:
            ended.set()
    return code, f"page of {page[0]} bytes" if page else "no page", err.getvalue()


def compute():
    """Maps of both devices, and the public names."""
    import numpy as np

    import haptorb

    missing = [name for name in haptorb.__all__ if not hasattr(haptorb, name)]
    omni, pmsm = haptorb.load("omni"), haptorb.load("pmsm")
    state = haptorb.State.at((0.0, 0.0, omni.contact_distance))
    force = haptorb.wrench_map(omni, state).matrix
    torque = haptorb.torque_characteristic(pmsm, np.eye(3))
    return {"missing": missing, "force": np.abs(force).max().item(), "torque": np.abs(torque).max().item()}


def record(folder):
    """Rows written to a file and read again."""
    import numpy as np

    from haptorb import Recording, load
    from haptorb.recording.mcap import Recorder
    from haptorb.recording.row import RowLayout

    layout = RowLayout.of(load("omni"))
    rows = np.random.default_rng(0).normal(size=(200, layout.width))
    path = folder / "run.mcap"
    with path.open("wb") as file:
        recorder = Recorder(file, layout, 1000.0, 10**18)
        recorder.append(rows)
        recorder.finish()
    recording = Recording(path)
    recording.to_csv(folder / "run.csv")
    return bool((recording.rows == rows).all())


def write_world(folder):
    """A world that does not return from a call after 300 ticks."""
    path = folder / "stuck.py"
    path.write_text(
        "import numpy as np\n\n\ndef Stuck(state):\n    while state.t > 0.3:\n        pass\n    return np.zeros(6)\n",
        encoding="utf-8",
    )
    return path


def run_servo(folder):
    """A dome felt from Python: the greatest force, the share of ticks in time, what a changed world and a Stop did."""
    import haptorb

    with haptorb.Servo("omni", "dome", record=folder / "servo.mcap") as servo:
        servo.point((0.012, 0.0, servo.device.contact_distance))
        servo.run(0.5)
        servo.set_world("wall")
        servo.run(0.2)
        servo.stop()
        servo.run(0.2)
    recording = haptorb.Recording(folder / "servo.mcap")
    rows, at = recording.rows, servo.layout
    force = ((rows[:, at["wrench_actual"]][:, :3] ** 2).sum(axis=1) ** 0.5).max()
    return {"rows": len(rows), "force": force, "last": abs(rows[-1, at["duty_applied"]]).max()}


def write_samples(folder):
    """A recording of some ticks of the simulated Omni, and a design file."""
    sys.path.insert(0, str(Path(__file__).parents[1]))
    from oracles.designs.small_design import write_design
    from oracles.recorded_chain import record_chain

    write_design(folder)
    return len(record_chain(folder / "ticks.mcap", ticks=50))


def use(folder):
    """Parts of the package that need no loop: name → what each came to."""
    designs = folder / "designs.toml"
    designs.write_text(DESIGNS, encoding="utf-8")
    study, answers = folder / "study.toml", folder / "study.db"
    run, sweep = folder / "ticks.mcap", folder / "sweep.sqlite"
    study.write_text('name = "small"\n[set_points]\npoints = [{ number = 1, theta_deg = 0 },'
                     '{ number = 2, theta_deg = 36, phi_deg = 0 }]\n[trials]\nrepetitions = 1\npractice = 0\n',
                     encoding="utf-8")  # fmt: skip
    return {
        "imports": import_everything,
        "compute": compute,
        "record": lambda: record(folder),
        "help": lambda: run_command("--help"),
        "devices": lambda: run_command("devices"),
        "worlds": lambda: run_command("worlds", "dome"),
        "inspect": lambda: run_command("inspect", "omni", "--json"),
        "inspect pmsm": lambda: run_command("inspect", "pmsm"),
        "check world": lambda: run_command("check", "--world", "dome", "--json"),
        "fit": lambda: run_command("fit-multipole", "pmsm", "--dipoles", 3, "--json"),
        "reproduce": lambda: run_command("reproduce", "bai2012", "--table", 2, "--out", folder, "--json"),
        "simulate": lambda: run_command("study", "simulate", study, "--db", answers, "--participants", 2),
        "analyse": lambda: run_command("study", "analyse", answers, "--out", folder / "report"),
        "analyse json": lambda: run_command("study", "analyse", answers, "--json"),
        "export": lambda: run_command("study", "export", answers, folder / "answers.csv"),
        "samples": lambda: write_samples(folder),
        "info": lambda: run_command("info", run),
        "export recording": lambda: run_command("export", run, "--to", "npz"),
        "replay": lambda: run_command("replay", run),
        "view": lambda: run_command("view", run, "--port", 0, "--duration", 0.1, "--json"),
        "design sweep": lambda: run_command(
            "design", "sweep", folder / "small.toml", "--into", sweep, "--count", 4, "--processes", 1
        ),
        "servo": lambda: run_servo(folder),
        "hang": lambda: run_command("run", "--world", f"{write_world(folder)}:Stuck", "--headless", "--duration", 5),
        "real servo": lambda: import_module("haptorb").Servo("omni", driver="serial:COM3"),
        "run": lambda: run_command(
            "run", "--headless", "--duration", 1, "--record", folder / "headless.mcap", "--json"
        ),
        "run console": lambda: run_with_page("run", "pmsm", "--port", 0),
        "serve": lambda: run_command("run", "--serve", "haply"),
        "study run": lambda: run_with_page("study", "run", study, "-p", "P01", "--port", 0, "--db", folder / "run.db"),
        "study run in a terminal": lambda: run_command("study", "run", study, "--terminal", "-p", "P01"),
        "feel": lambda: run_with_page("feel", designs, "--port", 0),
        "feel headless": lambda: run_command("feel", designs, "--headless", "--duration", 1, "--json"),
        "check": lambda: run_command("check"),
        "design show": lambda: run_with_page("design", "show", sweep, "--port", 0),
        "probe": lambda: run_command("hardware", "probe"),
        "monitor": lambda: run_command("hardware", "monitor", "--driver", "serial:COM3"),
        "emulate": lambda: run_command("hardware", "emulate"),
        "calibrate": lambda: run_command("calibrate", "--driver", "i2c:1", "--out", folder / "c.json"),
        "bench": lambda: run_command("bench", "loop"),
        "exec": lambda: run_command("exec", "--", sys.executable, "-c", "pass"),
        "libraries": lambda: run_command("libraries", folder / "kit"),
        "tracker": lambda: run_command("run", "--tracker", "osc:9000", "--headless", "--duration", 1),
    }


def main(system, folder, *only):
    """Hide, use, tell; `only` these parts, or with "without" before them all others."""
    hide(system)
    told = {}
    parts = use(Path(folder))
    wanted = [name for name in parts if name not in only] if only[:1] == ("without",) else only or parts
    for name in wanted:
        part = parts[name]
        begun = time.monotonic()
        try:
            told[name] = {"result": part()}
        except Exception as cause:  # the test says which
            told[name] = {"error": [type(cause).__name__, str(cause), traceback.format_exc()]}
        told[name]["seconds"] = round(time.monotonic() - begun, 2)
    print(json.dumps(told))


def run_module(system, module, arguments):
    """Run a process of a run, or a command."""
    hide(system, PACKAGES if module == "haptorb" else FEW_PACKAGES)
    sys.argv = [module, *arguments]
    runpy.run_module(module, run_name="__main__", alter_sys=True)


def run_file(system, file, arguments):
    """Run a user's script."""
    hide(system)
    sys.argv = [file, *arguments]
    sys.path[0] = str(Path(file).absolute().parent)
    runpy.run_path(file, run_name="__main__")


if __name__ == "__main__":
    if sys.argv[2] == "-m":
        run_module(sys.argv[1], sys.argv[3], sys.argv[4:])
    elif sys.argv[2] == "-f":
        run_file(sys.argv[1], sys.argv[3], sys.argv[4:])
    else:
        main(*sys.argv[1:])
