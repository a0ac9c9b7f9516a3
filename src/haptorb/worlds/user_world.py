"""World in a user's Python file: `groove.py:Groove`. Only files named at the start are ever loaded."""

from __future__ import annotations

import base64
import hashlib
import json
import linecache
import os
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import MISSING, Field, dataclass, field, fields, is_dataclass
from functools import cache
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from itertools import count
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any, final

import numpy as np

from haptorb.arrays import Array
from haptorb.devices.base import Device, State
from haptorb.earlier_names import find_module
from haptorb.errors import HaptorbError, InputError, UnknownName, quote
from haptorb.file_kind import FileKind
from haptorb.files import open_regular, read_bytes, read_text, state_folder
from haptorb.own_code import find_imports
from haptorb.worlds.base import Sum, World
from haptorb.worlds.client_force import Remote, join_remote
from haptorb.worlds.dome import Compass, Dome
from haptorb.worlds.dynamic import DynamicSum, MemoryNotFinite, bind_world
from haptorb.worlds.path import GuidancePath
from haptorb.worlds.scene import Scene, SceneFile
from haptorb.worlds.scene_physics import SceneModel, is_shipped_scene, make_scene_model
from haptorb.worlds.terrain import Terrain

__all__ = [
    "MAX_NOTE_CHARACTERS",
    "FileWithRemote",
    "FunctionWorld",
    "WorldFile",
    "check_wrench",
    "describe_failure",
    "find_started",
    "find_world_file",
    "fit_world",
    "is_world_file",
    "keep_source",
    "list_path",
    "load_noted_world",
    "make_world",
    "name_code",
    "note_scenes",
    "note_start",
    "note_world",
    "parse_world_file",
    "try_world",
]


# --------------------------------------------------------------------------------------------------
# World from a plain function of a state.


@dataclass(frozen=True)
class FunctionWorld(World):
    """Wrench given by `function(state)`: an array (6,), force [N] and torque [N·m]. It is assumed to be passive.

    >>> import numpy as np
    >>> pull = FunctionWorld(lambda state: np.append(-20 * state.p, np.zeros(3)))
    >>> pull.wrench(State.at((0, 0, 0.05))).tolist()
    [-0.0, -0.0, -1.0, 0.0, 0.0, 0.0]
    """

    function: Callable[[State], Array] | None = None

    def __post_init__(self) -> None:
        if not callable(self.function):
            raise InputError(f"FunctionWorld needs a function of a State; got {quote(self.function)}")

    @property
    def name(self) -> str:
        """The function's name in lower case; `function` for a lambda."""
        name = str(getattr(self.function, "__name__", "")).lower()
        return name if name.isidentifier() else "function"

    @property
    def wrench_code(self) -> Callable[..., Any]:
        """The function."""
        assert self.function is not None
        return self.function

    def _summarize(self) -> str:
        return f"FunctionWorld({self.name})"

    def wrench(self, state: State) -> Array:
        """(6,) result of the function [N, N·m]."""
        assert self.function is not None
        return self.function(state)


def make_world(given: object, where: str = "world") -> World:
    """World from user code: a World, a World class without required arguments, or a function of a State.

    Raises InputError for anything else, and for a class that requires arguments.
    """
    if isinstance(given, World):
        return given
    if isinstance(given, type):
        if not issubclass(given, World):
            raise InputError(f"{where}: class {given.__name__} must derive from haptorb.worlds.World")
        try:
            return given()
        except TypeError as cause:
            raise InputError(
                f"{where}: {given.__name__}() cannot be created ({cause}); a world needs a default for every field, "
                "and "
                "a method wrench(self, state)"
            ) from cause
    if callable(given):
        return FunctionWorld(given)
    raise InputError(
        f"{where} must be the name of a world, FILE.py:NAME, a World, or a function of a State that returns an array "
        f"(6,) of force and torque; got {quote(given)}"
    )


_MODULE_PREFIX = "haptorb_world_"  #: prefix of the names of modules that `WorldFile` creates


def is_world_file(text: str) -> bool:
    """Whether `text` names a file, `groove.py` or `groove.py:Groove`, and not a world of the catalogue."""
    return ".py:" in text.lower() or text.lower().endswith(".py")


def parse_world_file(text: str, folder: Path | None = None) -> WorldFile:
    """File and name in `text`; a relative path starts at `folder`, by default the working directory.

    >>> parse_world_file("groove.py:Groove").name
    'Groove'
    """
    path, _, name = text.rpartition(":") if ".py:" in text.lower() else (text, "", "")
    found = Path(path).expanduser()
    return WorldFile(Path(os.path.abspath((folder or Path()) / found)), name)


def name_code(world: World) -> str:
    """Name of the class or function that computes the wrench of `world`, within its module."""
    kind = type(world)
    return kind.__qualname__ if not kind.__module__.startswith("haptorb.") else world.wrench_code.__qualname__


def find_world_file(world: World) -> tuple[Path, str] | None:
    """File that `world` was loaded from as a `WorldFile`, and its name there; None for any other world."""
    code = getattr(world.wrench_code, "__code__", None)
    if not (isinstance(code, CodeType) and str(world.wrench_code.__module__).startswith(_MODULE_PREFIX)):
        return None
    return Path(code.co_filename), name_code(world)


@dataclass(frozen=True)
class WorldFile:
    """World `name` in the Python file `path`, with `values` for some of its parameters.

    name   a class of a World, a World, or a function of a State; empty: the only World class that the file defines
    """

    path: Path
    name: str = ""
    values: Mapping[str, Any] = field(default_factory=dict)

    def load(self, texts: Mapping[Path, str] | None = None) -> World:
        """Execute the file and return its world.

        texts: of the file, and of all that it may import from its folder, if only these may be executed.

        Raises InputError if the file cannot be read or fails, with file and line, or has no such world; UnknownName
        and InputError for values that its parameters do not allow.
        """
        module = self._run(texts)
        where = f"world file {self.path}"
        world = make_world(self._find(module), where)
        from haptorb.worlds import CATALOGUE

        if world.name in CATALOGUE and type(world) is not CATALOGUE[world.name]:
            raise InputError(
                f"{where}: '{world.name}' is the name of a world of the catalogue; rename the class, so that "
                "recordings tell them apart"
            )
        try:
            return world.replace(**self.values)
        except HaptorbError:
            raise
        except Exception as cause:  # of the user's constructor
            raise InputError(f"{where}: {_describe(cause, self.path)}") from cause

    @property
    def stamp(self) -> tuple[int, int, int] | None:
        """Stamp that changes when the file is saved: time [ns], size, inode; None if the file does not exist."""
        try:
            found = self.path.stat()
        except OSError:
            return None
        return found.st_mtime_ns, found.st_size, found.st_ino

    def _run(self, texts: Mapping[Path, str] | None) -> ModuleType:
        """Execute the file as a module of its own, with a unique name."""
        import cloudpickle

        if texts is None:
            text = read_text(self.path, "world file", InputError, kind=FileKind.WORLD)
        else:
            text = texts[self.path]
        module = ModuleType(f"{_MODULE_PREFIX}{self.path.stem}")
        module.__file__ = str(self.path)
        folder = str(self.path.parent)
        if texts is not None:
            sys.meta_path.append(_GivenTexts(self.path.parent, texts))
        elif folder not in sys.path:
            sys.path.append(folder)  # for modules beside it; last, so that they do not shadow others
        before = sys.modules.get(module.__name__)
        sys.modules[module.__name__] = module  # needed by dataclasses
        try:
            exec(compile(text, str(self.path), "exec"), module.__dict__)
        except BaseException as cause:  # of user code: also sys.exit
            if before is None:
                del sys.modules[module.__name__]
            else:
                sys.modules[module.__name__] = before
            if isinstance(cause, KeyboardInterrupt):
                raise
            raise InputError(f"world file {self.path}: {_describe(cause, self.path)}") from cause
        cloudpickle.register_pickle_by_value(module)  # the servo's process must not execute the file again
        return module

    def _find(self, module: ModuleType) -> object:
        own = {
            name: item
            for name, item in vars(module).items()
            if isinstance(item, type) and issubclass(item, World) and item.__module__ == module.__name__
        }
        if self.name:
            if self.name not in vars(module):
                raise UnknownName(f"world in {self.path}", self.name, own)
            return vars(module)[self.name]
        if len(own) != 1:
            found = f"has {', '.join(own)}" if own else "has no class that derives from haptorb.worlds.World"
            raise InputError(f"world file {self.path} {found}; name the world as {self.path.name}:NAME")
        return next(iter(own.values()))


def _describe(cause: BaseException, path: Path) -> str:
    """Error, and the lines of the user's file in its traceback."""
    linecache.checkcache(str(path))
    own = isinstance(cause, HaptorbError)  # the message is complete
    text = str(cause) if own else "".join(traceback.format_exception_only(cause)).strip()
    frames = [one for one in traceback.extract_tb(cause.__traceback__) if one.filename == str(path)]
    where = "".join(f'\n  File "{one.filename}", line {one.lineno}, in {one.name}\n    {one.line}' for one in frames)
    return text + where


@final
class _GivenTexts(MetaPathFinder, Loader):
    """Finds the modules of `folder` in `texts`: neither the folder itself nor a compiled file in it is read."""

    def __init__(self, folder: Path, texts: Mapping[Path, str]) -> None:
        self._folder, self._texts = folder, texts

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Spec of the module `name`, if its text is available."""
        place = self._folder.joinpath(*name.split("."))
        for file, package in ((place / "__init__.py", True), (place.with_name(f"{place.name}.py"), False)):
            if file in self._texts:
                found = ModuleSpec(name, self, origin=str(file), is_package=package)
                found.has_location = True
                return found
        if any(file.is_relative_to(place) for file in self._texts):  # folder without __init__.py
            return ModuleSpec(name, None, is_package=True)
        return None

    def exec_module(self, module: ModuleType) -> None:
        """Execute its text."""
        file = str(module.__file__)
        exec(compile(self._texts[Path(file)], file, "exec"), module.__dict__)


# --------------------------------------------------------------------------------------------------
# Messages for failures in a world's code: the error, and where in the user's files it was raised.


_PACKAGE = str(Path(__file__).parents[1])
_FIRST_CALL_STEP_S = 1e-3  #: time step of a world's first call [s]
_FRAMES = 6  #: maximum number of frames of the user's code, the innermost; a recursion has a thousand


def check_wrench(wrench: object) -> Array:
    """Return `wrench`, (6,) [N, N·m]. Raises InputError if it is not such an array; the guard checks its numbers."""
    if not isinstance(wrench, np.ndarray):
        raise InputError(f"wrench must return an array of 6 numbers (force, torque); got {quote(wrench)}")
    if wrench.shape != (6,):
        raise InputError(f"wrench must return an array of shape (6,): force, torque; got shape {wrench.shape}")
    return wrench


def describe_failure(world: World, cause: BaseException) -> str:
    """Error in one line, then file, line and source of the user's code in the traceback, outermost first.

    An invalid wrench is not raised by a line of the user's code; the message then shows the first line of `wrench`.
    """
    if isinstance(cause, SystemExit):
        text = f"the world called sys.exit({cause})"
    elif isinstance(cause, InputError | MemoryNotFinite):
        text = str(cause)
    else:
        text = f"{type(cause).__name__}: {cause}"
    frames = [
        (frame.f_code, line)
        for frame, line in traceback.walk_tb(cause.__traceback__)
        if not frame.f_code.co_filename.startswith(_PACKAGE)
    ]
    code = _code_of(world)
    if not frames and code is not None:
        frames = [(code, code.co_firstlineno)]
    lines = [text]
    for found, line in frames[-_FRAMES:]:
        lines.append(f'  File "{found.co_filename}", line {line}, in {found.co_qualname}')
        if source := linecache.getline(found.co_filename, line).strip():
            lines.append(f"    {source}")
    return "\n".join(lines)


def keep_source(world: World) -> None:
    """Read the file of `world` now, so that `describe_failure` does not open it later and shows the executed lines."""
    code = _code_of(world)
    if code is not None:
        linecache.checkcache(code.co_filename)
        linecache.getlines(code.co_filename)


def fit_world(world: World, device: Device) -> World:
    """Return `world.for_device(device)`, the world that `device` renders; a world with memory is started once.

    Raises InputError with the place in the user's code if that fails, or as the world itself does if `device` cannot
    render it.
    """
    try:
        fitted: object = world.for_device(device)
        if isinstance(fitted, World):
            bind_world(fitted, _FIRST_CALL_STEP_S)
    except HaptorbError:
        raise
    except BaseException as cause:  # of user code: also sys.exit
        if isinstance(cause, KeyboardInterrupt):
            raise
        raise InputError(f"world '{world.name}' failed: {describe_failure(world, cause)}") from cause
    if not isinstance(fitted, World):
        raise InputError(
            f"for_device of world '{world.name}' must return a World for the device (may be the same one); got "
            f"{quote(fitted)}"
        )
    return fitted


def try_world(world: World, device: Device) -> World:
    """Return `world` after one successful call at the device's rest position.

    Raises InputError with the place in the user's code if it fails there, or if `device` cannot render it.
    """
    fitted = fit_world(world, device)
    try:
        rendered = bind_world(fitted, _FIRST_CALL_STEP_S) or fitted
        check_wrench(rendered.wrench(State.at(device.rest_position, R_SR=np.eye(3))))
    except BaseException as cause:  # of user code: also sys.exit
        if isinstance(cause, KeyboardInterrupt):
            raise
        raise InputError(f"world '{world.name}' failed: {describe_failure(world, cause)}") from cause
    return world


def _code_of(world: World) -> CodeType | None:
    """Code of the world's `wrench`, if it is Python code outside this package."""
    code = getattr(world.wrench_code, "__code__", None)
    return code if isinstance(code, CodeType) and not code.co_filename.startswith(_PACKAGE) else None


# --------------------------------------------------------------------------------------------------
# World or scene of a user, reloaded whenever its file is saved, with the clients' force added to it.


@final
@dataclass(frozen=True)
class FileWithRemote:
    """World in `file` plus the force of clients. The loop keeps the force when the file is reloaded."""

    file: WorldFile | SceneFile

    def load(self) -> World:
        """Sum of both. Raises what `file.load` raises."""
        return join_remote(self.file.load(), Remote())


# --------------------------------------------------------------------------------------------------
# World files that this account has started by name: a list of digests in its state folder.
#
# A recording names the file that its world came from, and that file's digest; but the author of the recording controls
# both. So a recording alone never executes code, and no file is opened because a recording names it. Its file is read
# only if this account has started a world from that path, and executed again only if it has started exactly that code:
# the file, the world in it, and every module that it imports from its folder, in their present state. These texts are
# read once; the compared text is the executed one (`WorldFile.load`). A scene's file is in the same list.


_MAX_LIST_BYTES = 4 << 20  #: bytes of the list


def list_path() -> Path:
    """List of this account: one line for each code with its digest and, for people, its file."""
    return state_folder() / "started-worlds"


def note_start(world: World) -> None:
    """Add to the list of started worlds the world file that `world` came from, and the files of its scenes.

    Where the list cannot be written, recordings of the world show its recorded wrench.
    """
    found = find_world_file(world)
    if found is not None:
        path, name = found
        with suppress(OSError, HaptorbError):
            _add_to_list(path, _started_code_digest(path, name, _read_code(path)))
    note_scenes(world)


def note_scenes(world: World) -> None:
    """Add the files of the scenes in `world`, a part of a sum for example, to the list of started worlds."""
    for path in _find_scene_files(world):
        if not is_shipped_scene(path):
            with suppress(OSError, HaptorbError):
                _add_to_list(path, _started_scene_digest(path, _world_note_digest(path)))


def _find_scene_files(value: Any) -> Iterator[Path]:
    if isinstance(value, SceneModel):
        if value.file is not None:
            yield value.file
    elif isinstance(value, tuple | list):
        for one in value:
            yield from _find_scene_files(one)
    elif isinstance(value, World) and is_dataclass(value):
        for one in fields(value):
            yield from _find_scene_files(getattr(value, one.name, None))


def _add_to_list(path: Path, digest: str) -> None:
    known = list_path()
    if digest in _read_list(known):
        return
    known.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND | getattr(os, "O_NOFOLLOW", 0)
    descriptor = os.open(known, flags, 0o600)
    try:
        # one call: atomic with respect to other processes
        os.write(descriptor, f"{digest} {json.dumps(str(path))}\n".encode())
    finally:
        os.close(descriptor)


def find_started(path: Path, name: str, digest: str) -> dict[Path, str]:
    """Return the texts of the file `path`, which had that `digest`, and of its imports from its folder, if this account
    has started the world `name` with exactly these by name.

    Raises InputError, with the reason, if it has not; a file from which it has started none is not opened.
    """
    known = _read_list(list_path())
    refusal = InputError(
        f"its code in {path}, with its imports from that folder, is not on this account's list of started worlds; "
        "code is not executed because a recording names it"
    )
    if str(path) not in known.values():  # safety: recordings-open-no-file
        raise refusal
    if not path.is_file():
        raise InputError(f"its code was in {path}, which is missing")
    if _world_note_digest(path) != digest:
        raise InputError(f"its code in {path} has changed")
    code = _read_code(path)
    if _started_code_digest(path, name, code) not in known:  # safety: recordings-run-no-code
        raise refusal
    return code


def _read_code(path: Path) -> dict[Path, str]:
    text = read_text(path, "world file", InputError)
    return {path: text, **find_imports(path, text)}


def _started_code_digest(path: Path, name: str, code: Mapping[Path, str]) -> str:
    """Digest of the file's path, the world's name, and all texts with their paths."""
    texts = {str(file): hashlib.sha256(text.encode()).hexdigest() for file, text in code.items()}
    return hashlib.sha256(json.dumps([str(path), name, texts], sort_keys=True).encode()).hexdigest()


def _started_scene_digest(path: Path, digest: str) -> str:
    """Digest of the path of a scene's file, and of the `digest` of its content."""
    return hashlib.sha256(json.dumps([str(path), "scene", digest]).encode()).hexdigest()


def _read_list(path: Path) -> dict[str, str]:
    """Digest → path of each entry of the list; none if another account could have written it."""
    try:
        with open_regular(path, "list of started worlds", InputError) as file:
            own = _is_own(os.fstat(file.fileno()))  # safety: own-list-only
            lines = file.read(_MAX_LIST_BYTES).splitlines() if own else []
    except InputError:
        return {}
    found = {}
    for line in lines:
        with suppress(ValueError):  # a line that was cut off
            found[line[:64].decode("ascii", "replace")] = str(json.loads(line[65:]))
    return found


def _is_own(facts: os.stat_result) -> bool:
    """Whether only this account can have written a file; true where the system does not report it."""
    return not hasattr(os, "geteuid") or (facts.st_uid == os.geteuid() and not facts.st_mode & 0o022)


# --------------------------------------------------------------------------------------------------
# World as text, so that a recording can be replayed: package worlds by name and parameters, user code by digest.
#
# Such a text is never executed, and neither is code that it names: a file of user code is executed again only if this
# account has started exactly that code by name (`find_started`). Worlds of the catalogue, sums, scenes and paths are
# created again with their values, nothing else (`_check_field`): these reach compiled code, which does not check its
# arrays. A scene's file is loaded only if it is supplied, or this account has started it, and it is unchanged.


MAX_NOTE_CHARACTERS = 1_000_000  #: of the text of a world
_MAX_OBJECTS = 200  #: worlds and paths in it, those in sums included
_ROOM = "haptorb.worlds."
_DEEPEST = 12
_MAX_NOTED_NUMBER = 1e6  #: magnitude of a number that is not a parameter: lengths in m, moments in A·m²
_MAX_FILE_BYTES = 16 << 20  #: of a world's or scene's own file
#: types of arrays in a text
_TYPES = frozenset({"<f8", "<f4", "<i8", "<i4", "<i2", "<u8", "<u4", "<u2", "|i1", "|u1", "|b1"})


class _OwnCode(Exception):
    """Value that is user code."""


def note_world(world: World) -> str:
    """Serialise `world` to JSON: "made" with the values of a world of the package, or "code" with file, name and
    digest.

    >>> from haptorb.worlds import find_world
    >>> load_noted_world(note_world(find_world("dome")())) == find_world("dome")()
    True
    """
    try:
        return json.dumps({"made": _encode(world)})
    except _OwnCode:
        return json.dumps({"code": _describe_code(world)})


def load_noted_world(text: str) -> World:
    """Deserialise a world from the text of `note_world`.

    Raises InputError, with the reason, if this version of haptorb cannot create it, or if the code or scene is
    missing, has changed, or was not started by this account.
    """
    try:
        if len(text) > MAX_NOTE_CHARACTERS:
            raise InputError(f"its description is longer than {MAX_NOTE_CHARACTERS} characters")
        note = json.loads(text)
        if "code" in note:
            return _load_code(note["code"])
        world = _decode(note["made"], 0, count())
    except HaptorbError:
        raise
    except Exception as cause:  # another program may have written it
        raise InputError(f"this version of haptorb cannot create it ({type(cause).__name__}: {cause})") from cause
    if not isinstance(world, World):
        raise InputError(f"the metadata state no world: {quote(text)}")
    return world


def _encode(value: Any) -> Any:
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, tuple | list):
        return {"tuple": [_encode(one) for one in value]}
    if isinstance(value, np.ndarray) and value.dtype.str in _TYPES:
        data = base64.b64encode(np.ascontiguousarray(value).tobytes()).decode()
        return {"array": data, "dtype": value.dtype.str, "shape": list(value.shape)}
    if isinstance(value, SceneModel) and value.file is not None:
        return {"scene": str(value.file), "digest": _world_note_digest(value.file)}
    kind = type(value)
    if not (is_dataclass(value) and kind.__module__.startswith(_ROOM)):
        raise _OwnCode
    made = {
        one.name: _encode(getattr(value, one.name))
        for one in fields(value)
        if one.init and not _is_default(one, getattr(value, one.name))
    }
    return {"kind": f"{kind.__module__}:{kind.__qualname__}", "fields": made}


def _is_default(one: Field[Any], value: Any) -> bool:
    """Whether a field that is not a number, a height map for example, has its default."""
    if one.default_factory is MISSING or not isinstance(value, np.ndarray):
        return False
    usual = one.default_factory()
    return isinstance(usual, np.ndarray) and usual.dtype == value.dtype and np.array_equal(usual, value)


def _decode(value: Any, depth: int, objects: Iterator[int]) -> Any:
    """Value of a note; `objects` counts the worlds and paths in it."""
    if depth > _DEEPEST:
        raise InputError("it is nested too deeply")
    if not isinstance(value, dict):
        return value
    if "tuple" in value:
        return tuple(_decode(one, depth + 1, objects) for one in value["tuple"])
    if "array" in value:
        if value["dtype"] not in _TYPES:  # safety: noted-arrays-are-numbers
            raise InputError(f"an array of {quote(value['dtype'])} is not numeric")
        shape = tuple(map(int, value["shape"]))
        return np.frombuffer(base64.b64decode(value["array"]), np.dtype(value["dtype"])).reshape(shape).copy()
    if "scene" in value:
        return _load_scene(str(value["scene"]), str(value["digest"]))
    module, _, name = str(value["kind"]).partition(":")
    module = find_module(module, name)
    if not module.startswith(_ROOM):
        raise InputError(f"{quote(value['kind'])} is not a world of haptorb")
    kind = _list_noted_kinds().get(f"{module}:{name}")
    if kind is None:
        raise InputError(f"{quote(value['kind'])} is not a world of this version of haptorb")
    if next(objects) >= _MAX_OBJECTS:
        raise InputError(f"it consists of more than {_MAX_OBJECTS} worlds")
    given = {key: _decode(one, depth + 1, objects) for key, one in value["fields"].items()}
    known = {one.name: one for one in fields(kind) if one.init}
    for key, one in given.items():
        if key in known:  # else the constructor raises TypeError
            _check_field(known[key], one)
    return kind(**given)


@cache
def _list_noted_kinds() -> dict[str, type[Any]]:
    """Classes whose values a note may state: "module:name" → class."""
    from haptorb.worlds import CATALOGUE

    kinds: set[type[Any]] = {*CATALOGUE.values(), Sum, DynamicSum, Scene, GuidancePath}
    return {f"{kind.__module__}:{kind.__qualname__}": kind for kind in kinds}


_MAX_NAME_CHARACTERS = 200
#: annotation of a field that is not a parameter → its types in a note
_NOTED_TYPES: dict[str, tuple[type[Any], ...]] = {
    "float": (int, float), "int": (int,), "bool": (bool,), "str": (str,), "Model": (str,), "Array": (np.ndarray,),
    "Literal['corrected', 'printed']": (str,), "Dome": (Dome,), "Compass": (Compass,), "Terrain": (Terrain,),
    "Any": (SceneModel,), "Device | None": (type(None),),
    "GuidancePath | tuple[tuple[float, ...], ...] | None": (GuidancePath, tuple, type(None)),
    "tuple[tuple[float, ...], ...]": (tuple,), "tuple[World, ...]": (tuple,),
}  # fmt: skip


def _check_field(known: Field[Any], value: Any) -> None:
    """Raise InputError unless `value` is one for the field `known` of a class in a note.

    Parameters are checked by every constructor, and so are arrays and tuples of numbers by their classes.
    """
    if "about" in known.metadata:
        return
    types = _NOTED_TYPES.get(str(known.type), ())
    fits = isinstance(value, types) and (bool in types or not isinstance(value, bool))
    if isinstance(value, int | float) and not isinstance(value, bool):
        fits = fits and abs(value) < _MAX_NOTED_NUMBER  # false for NaN
    if isinstance(value, str):
        fits = fits and len(value) <= _MAX_NAME_CHARACTERS
    if known.type == "tuple[World, ...]" and isinstance(value, tuple):
        fits = fits and all(isinstance(one, World) for one in value)
    if not fits:  # safety: noted-fields
        raise InputError(f"its {known.name} cannot be {quote(value)}")


def _load_scene(name: str, digest: str) -> SceneModel:
    """Scene of the file `name` if it is a supplied one, or this account has started it, and has that `digest`."""
    path = Path(name)
    shipped = is_shipped_scene(path)
    known = {} if shipped else _read_list(list_path())
    if not shipped and name not in known.values():  # safety: recordings-open-no-scene
        raise InputError(
            f"its scene {path} is not on this account's list of started scenes; a file is not read because a "
            "recording names it. If it is yours, start it once: haptorb run --scene FILE"
        )
    if _world_note_digest(path) != digest or not (shipped or _started_scene_digest(path, digest) in known):
        raise InputError(f"the scene {path} has changed, or is missing")
    return make_scene_model(path)


def _world_note_digest(path: Path) -> str:
    """Digest of a regular file of limited size; empty for anything else."""
    try:
        return hashlib.sha256(read_bytes(path, _MAX_FILE_BYTES, "file of a world", InputError)).hexdigest()
    except InputError:
        return ""


def _describe_code(world: World) -> dict[str, str]:
    """File, name and digest of the code, and whether the file only defines a world."""
    code = getattr(world.wrench_code, "__code__", None)
    file = Path(code.co_filename) if isinstance(code, CodeType) else Path()
    return {
        "file": str(file),
        "name": name_code(world),
        "digest": _world_note_digest(file),
        "loaded": "yes" if find_world_file(world) else "",
        "made": repr(world)[:400],
    }


def _load_code(code: Mapping[str, Any]) -> World:
    path, name = Path(str(code["file"])), str(code["name"])
    if not code["digest"]:
        raise InputError(f"its code was not in a file: {quote(code['made'])}")
    if not code["loaded"]:
        raise InputError(f"its code is in the program {path}, which is not executed; use --world FILE.py:NAME")
    plain = "" if "." in name or "<" in name else name
    texts = find_started(path, name, str(code["digest"]))
    return WorldFile(path, plain).load(texts)
