"""Compiles a scene with MuJoCo in a separate process, with limits on time and memory, and takes one step.

MuJoCo's compiler reads untrusted files: a mesh or a number can take hours, all memory, or crash it. Here this affects a
child process only. The child loads MuJoCo's library and nothing else, and starts within a tenth of a second.
"""

from __future__ import annotations

import ctypes
import os
import sys
from pathlib import Path
from typing import Any

__all__ = ["compile_scene"]

_SECONDS = 10  #: processor time
_MEMORY = 4 * 1024**3  #: bytes of address space
_FILE = 1024**3  #: bytes of the compiled model


def compile_scene(engine: Any, path: Path) -> Any:
    """Compile the scene in `path` to an MjModel. Raises ProcessFailure if it does not compile within the limits."""
    from haptorb.files import private_temporary_folder
    from haptorb.limited_process import ProcessFailure, run_limited

    library = next(Path(engine.__file__).parent.glob("libmujoco.so.*"), None)
    if library is None:  # not on Linux
        return engine.MjModel.from_xml_path(str(path))
    with private_temporary_folder("scene") as folder:  # MuJoCo trusts a compiled model
        made = folder / "model.mjb"
        words = [str(library), str(path.absolute()), str(made)]
        run_limited(Path(__file__), words, folder, _SECONDS, _MEMORY)
        if not made.is_file():
            raise ProcessFailure("MuJoCo did not write a model")
        return engine.MjModel.from_binary_path(str(made))


def _compile(library: str, path: str, made: str) -> int:
    """Run in the child process: compile, take one step, write the model."""
    engine = ctypes.CDLL(library, mode=ctypes.RTLD_GLOBAL)
    for name in ("mj_loadXML", "mj_makeData"):
        getattr(engine, name).restype = ctypes.c_void_p
    plugins = os.path.join(os.path.dirname(library), "plugin")
    if os.path.isdir(plugins):
        engine.mj_loadAllPluginLibraries(plugins.encode(), None)
    message = ctypes.create_string_buffer(1000)
    model = engine.mj_loadXML(os.fsencode(path), None, message, len(message))
    if not model:
        print(message.value.decode("utf-8", "replace"))
        return 1
    data = engine.mj_makeData(ctypes.c_void_p(model))
    if not data:
        print("could not allocate its state")
        return 1
    engine.mj_step(ctypes.c_void_p(model), ctypes.c_void_p(data))
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
