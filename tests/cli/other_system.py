"""Another operating system, for want of one: `python other_system.py win32 FOLDER` hides what only Linux has.

Then it uses what needs no real-time loop, and prints one JSON object: name of each part, and what it came to.
"""

import ctypes
import io
import json
import mmap
import os
import pkgutil
import re
import select
import signal
import socket
import sys
import tempfile
import time
import traceback
import warnings
from contextlib import redirect_stderr, redirect_stdout
from functools import partial
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

#: modules of Linux, attributes of modules that Windows does not have, and folders of Linux
MODULES = "fcntl resource termios tty pty pwd grp syslog posix readline curses smbus2 serial.serialposix"
ATTRIBUTES = {
    os: r"sched_|posix_|memfd_|pidfd_|eventfd|timerfd|splice|fork|register_at_fork|(get|set)e?[ug]id|(get|set)res|"
    r"(get|set)priority|getloadavg|uname|sysconf|pathconf|fpathconf|p(read|write)v?$|fchmod|fchown|chown|lchown|killpg|"
    r"(get|set)p?[gs]id|set_blocking|get_blocking|pipe2|mkfifo|mknod|statvfs|sendfile|wait[34i]|openpty|ttyname|nice$|"
    r"O_(NONBLOCK|CLOEXEC|NOFOLLOW|DIRECTORY|SYNC|DSYNC|NOCTTY|PATH|TMPFILE)|SCHED_|PRIO_|MFD_|WNOHANG|CLONE_",
    signal: r"SIG(KILL|HUP|USR|ALRM|CHLD|STOP|CONT|TSTP|QUIT|RT|XCPU|IO|PIPE)|setitimer|alarm|"
    r"pause|pthread_|sig(wait|pend)",
    select: r"e?poll|EPOLL|POLL",
    socket: r"AF_UNIX|AF_NETLINK|AF_PACKET|SO_REUSEPORT|MSG_(DONTWAIT|NOSIGNAL)|SCM_|send_fds|recv_fds|CMSG_",
    mmap: r"MAP_|PROT_|MADV_",
    time: r"clock_|CLOCK_|pthread_|tzset",
}  # fmt: skip
FOLDERS = re.compile(r"/(proc|sys|dev(?!/(null|u?random)\b)|run)(/|$)")

#: of haptorb itself: what is not even imported elsewhere
OF_LINUX = re.compile(r"haptorb\.runtime\.(keep_core_awake|loop|\w+_process)\b")


def hide(system):
    """From here on this is `system` ("win32"), as far as Python tells."""
    for name in PACKAGES.split():
        import_module(name)
    # On Windows a process is spawned without this helper, and there is one way to end it. Here the helper starts before
    # its calls are hidden.
    sys.modules["multiprocessing.resource_tracker"].ensure_running()
    process = sys.modules["multiprocessing.popen_fork"].Popen
    process.kill = process.terminate
    for name in MODULES.split():
        sys.modules[name] = None
    # asyncio and threadpoolctl do on each system what is right there
    socket.socketpair = partial(socket.socketpair, socket.AF_UNIX)
    threadpoolctl.ThreadpoolController._find_libraries_with_linux = lambda self: None
    for module, names in ATTRIBUTES.items():
        for name in [name for name in vars(module) if re.match(names, name)]:
            delattr(module, name)
    tempfile._O_TMPFILE_WORKS = False  # it looked for the flag when it was imported
    load = ctypes.CDLL.__init__

    def load_library(self, name, *others, **more):
        if name is None:
            raise TypeError("a library has a name")
        load(self, name, *others, **more)

    ctypes.CDLL.__init__ = load_library
    sys.addaudithook(refuse_folders)
    warnings.filterwarnings("error", category=EncodingWarning, module=r"haptorb\.")  # a file's text has an encoding
    # Not sys.platform itself: other people's packages would load another system's parts, late ones too.
    from haptorb.runtime import linux

    linux.sys = SimpleNamespace(platform=system)


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
    return {name: why for name, why in failed.items() if not OF_LINUX.match(name)}


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


def write_samples(folder):
    """A recording of some ticks of the simulated Omni, and a design file."""
    sys.path.insert(0, str(Path(__file__).parents[1]))
    from oracles.designs.small_design import write_design
    from oracles.recorded_chain import record_chain

    write_design(folder)
    return len(record_chain(folder / "ticks.mcap", ticks=50))


def use(folder):
    """Parts of the package that need no loop: name → what each came to."""
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
        "servo": lambda: import_module("haptorb").Servo("omni"),
        "run": lambda: run_command("run"),
        "study run": lambda: run_command("study", "run", study),
        "feel": lambda: run_command("feel", "designs.toml"),
        "check": lambda: run_command("check"),
        "design show": lambda: run_command("design", "show", sweep),
        "probe": lambda: run_command("hardware", "probe"),
        "monitor": lambda: run_command("hardware", "monitor", "--driver", "serial:COM3"),
        "emulate": lambda: run_command("hardware", "emulate"),
        "calibrate": lambda: run_command("calibrate", "--driver", "i2c:1", "--out", folder / "c.json"),
        "bench": lambda: run_command("bench", "loop"),
    }


def main(system, folder):
    """Hide, use, tell."""
    hide(system)
    told = {}
    for name, part in use(Path(folder)).items():
        begun = time.monotonic()
        try:
            told[name] = {"result": part()}
        except Exception as cause:  # the test says which
            told[name] = {"error": [type(cause).__name__, str(cause), traceback.format_exc()]}
        told[name]["seconds"] = round(time.monotonic() - begun, 2)
    print(json.dumps(told))


if __name__ == "__main__":
    main(*sys.argv[1:])
