"""Compiles a scene with MuJoCo in a separate process, with limits on time and memory, and takes one step.

MuJoCo's compiler reads untrusted files: a mesh or a number can take hours, all memory, or crash it. Here this affects a
child process only. The child loads MuJoCo's library and nothing else, and starts within a tenth of a second.

The child gets the content of all files from its parent, and can open none while it compiles: a name that was not
checked, or a file that changed after the check, is not read.
"""

from __future__ import annotations

import ctypes
import json
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

__all__ = ["compile_scene"]

_SECONDS = 10  #: processor time
_MEMORY = 4 * 1024**3  #: bytes of address space
_FILE = 1024**3  #: bytes of the compiled model


def compile_scene(engine: Any, path: Path, files: Mapping[str, bytes]) -> Any:
    """Compile the scene in `path` to an MjModel. Raises ProcessFailure if it does not compile within the limits.

    files  content of the scene and of the files that it names, from `check_scene_file`
    """
    from haptorb.files import private_temporary_folder
    from haptorb.limited_process import ProcessFailure, run_limited

    library = next(Path(engine.__file__).parent.glob("libmujoco.so.*"), None)
    if library is None:  # not on Linux
        return engine.MjModel.from_xml_path(str(path), dict(files))
    with private_temporary_folder("scene") as folder:  # MuJoCo trusts a compiled model
        made = folder / "model.mjb"
        words = [str(library), os.path.abspath(path), str(made)]
        run_limited(Path(__file__), words, folder, _SECONDS, _MEMORY, _pack(files))
        if not made.is_file():
            raise ProcessFailure("MuJoCo did not write a model")
        return engine.MjModel.from_binary_path(str(made))


def _pack(files: Mapping[str, bytes]) -> bytes:
    """A line with name and size of each file, and their contents."""
    head = json.dumps([(name, len(content)) for name, content in files.items()])
    return b"".join([head.encode(), b"\n", *files.values()])


class _FileSystem(ctypes.Structure):
    """MuJoCo's mjVFS."""

    _fields_ = (("content", ctypes.c_void_p),)


def _unpack(engine: ctypes.CDLL, stream: BinaryIO) -> _FileSystem:
    """Files in memory, with the content from `stream`."""
    files = _FileSystem()
    engine.mj_defaultVFS(ctypes.byref(files))
    for name, size in json.loads(stream.readline()):
        content = stream.read(size)
        engine.mj_addBufferVFS(ctypes.byref(files), os.fsencode(name), content, ctypes.c_int(size))
    return files


def _compile(library: str, path: str, made: str) -> int:
    """Run in the child process: compile, take one step, write the model."""
    import resource

    engine = ctypes.CDLL(library, mode=ctypes.RTLD_GLOBAL)
    for name in ("mj_loadXML", "mj_makeData"):
        getattr(engine, name).restype = ctypes.c_void_p
    plugins = os.path.join(os.path.dirname(library), "plugin")
    if os.path.isdir(plugins):
        engine.mj_loadAllPluginLibraries(plugins.encode(), None)
    files = _unpack(engine, sys.stdin.buffer)
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    # MuJoCo opens what it does not find in memory; with no descriptor left, every such call fails.
    resource.setrlimit(resource.RLIMIT_NOFILE, (0, hard))  # safety: compiler-opens-nothing
    message = ctypes.create_string_buffer(1000)
    model = engine.mj_loadXML(os.fsencode(path), ctypes.byref(files), message, len(message))
    if not model:
        print(message.value.decode("utf-8", "replace"))
        return 1
    data = engine.mj_makeData(ctypes.c_void_p(model))
    if not data:
        print("could not allocate its state")
        return 1
    engine.mj_step(ctypes.c_void_p(model), ctypes.c_void_p(data))
    resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    engine.mj_saveModel(ctypes.c_void_p(model), made.encode(), None, 0)
    return 0


def _main() -> int:
    import runpy  # haptorb itself is not on the path of this process, and need not be loaded

    limits = runpy.run_path(str(Path(__file__).parents[1] / "limited_process.py"))
    limits["set_limits"](int(sys.argv[1]), int(sys.argv[2]), _FILE)
    return _compile(*sys.argv[3:6])


if __name__ == "__main__":
    code = _main()
    sys.stdout.flush()
    os._exit(code)
