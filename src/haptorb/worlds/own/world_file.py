"""A world in a user's Python file: `groove.py:Groove`. Only files named at the start are ever loaded."""

from __future__ import annotations

import linecache
import os
import sys
import traceback
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any, final

from haptorb.errors import HaptorbError, InputError, UnknownName
from haptorb.files.file_kind import FileKind
from haptorb.files.text_file import read_text
from haptorb.worlds.own.function_world import make_world
from haptorb.worlds.world import World

__all__ = ["WorldFile", "find_world_file", "is_world_file", "name_code", "parse_world_file"]

_LOADED = "haptorb_world_"  #: begins the names of modules that `WorldFile` makes


def is_world_file(text: str) -> bool:
    """Whether `text` names a file, `groove.py` or `groove.py:Groove`, and not a world of the catalogue."""
    return text.partition(".py:")[0] != text or text.endswith(".py")


def parse_world_file(text: str, folder: Path | None = None) -> WorldFile:
    """The file and name in `text`; a relative path starts at `folder`, by default the working directory.

    >>> parse_world_file("groove.py:Groove").name
    'Groove'
    """
    path, _, name = text.rpartition(":") if ".py:" in text else (text, "", "")
    found = Path(path).expanduser()
    return WorldFile(Path(os.path.abspath((folder or Path()) / found)), name)


def name_code(world: World) -> str:
    """The name of the class or function that computes the wrench of `world`, within its module."""
    kind = type(world)
    return kind.__qualname__ if not kind.__module__.startswith("haptorb.") else world.wrench_code.__qualname__


def find_world_file(world: World) -> tuple[Path, str] | None:
    """The file that `world` was loaded from as a `WorldFile`, and its name there; None for any other world."""
    code = getattr(world.wrench_code, "__code__", None)
    if not (isinstance(code, CodeType) and str(world.wrench_code.__module__).startswith(_LOADED)):
        return None
    return Path(code.co_filename), name_code(world)


@dataclass(frozen=True)
class WorldFile:
    """The world `name` in the Python file `path`, with `values` for some of its parameters.

    name   a class of a World, a World, or a function of a State; empty: the only World class that the file defines
    """

    path: Path
    name: str = ""
    values: Mapping[str, Any] = field(default_factory=dict)

    def load(self, texts: Mapping[Path, str] | None = None) -> World:
        """Run the file and return its world.

        texts: of the file, and of all that it may import from its folder, where these and nothing else must run.

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
        except Exception as cause:  # its own constructor
            raise InputError(f"{where}: {_describe(cause, self.path)}") from cause

    @property
    def stamp(self) -> tuple[int, int, int] | None:
        """A stamp that changes when the file is saved: time [ns], size, inode; None if the file does not exist."""
        try:
            found = self.path.stat()
        except OSError:
            return None
        return found.st_mtime_ns, found.st_size, found.st_ino

    def _run(self, texts: Mapping[Path, str] | None) -> ModuleType:
        """The file as a module of its own, known by a name that no other module has."""
        import cloudpickle

        if texts is None:
            text = read_text(self.path, "world file", InputError, kind=FileKind.WORLD)
        else:
            text = texts[self.path]
        module = ModuleType(f"{_LOADED}{self.path.stem}")
        module.__file__ = str(self.path)
        folder = str(self.path.parent)
        if texts is not None:
            sys.meta_path.append(_GivenTexts(self.path.parent, texts))
        elif folder not in sys.path:
            sys.path.append(folder)  # for modules beside it; last, so that they hide nothing
        before = sys.modules.get(module.__name__)
        sys.modules[module.__name__] = module  # dataclasses look for it there
        try:
            exec(compile(text, str(self.path), "exec"), module.__dict__)
        except BaseException as cause:  # the user's code: also sys.exit
            if before is None:
                del sys.modules[module.__name__]
            else:
                sys.modules[module.__name__] = before
            if isinstance(cause, KeyboardInterrupt):
                raise
            raise InputError(f"world file {self.path}: {_describe(cause, self.path)}") from cause
        cloudpickle.register_pickle_by_value(module)  # the servo's process must not run the file again
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
    """The error, and the lines of the user's file that it went through."""
    linecache.checkcache(str(path))
    own = isinstance(cause, HaptorbError)  # says all by itself
    text = str(cause) if own else "".join(traceback.format_exception_only(cause)).strip()
    frames = [one for one in traceback.extract_tb(cause.__traceback__) if one.filename == str(path)]
    where = "".join(f'\n  File "{one.filename}", line {one.lineno}, in {one.name}\n    {one.line}' for one in frames)
    return text + where


@final
class _GivenTexts(MetaPathFinder, Loader):
    """Finds the modules of `folder` in `texts`: neither the folder itself nor a compiled file in it is looked at."""

    def __init__(self, folder: Path, texts: Mapping[Path, str]) -> None:
        self._folder, self._texts = folder, texts

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Of the module `name`, if its text is there."""
        place = self._folder.joinpath(*name.split("."))
        for file, package in ((place / "__init__.py", True), (place.with_name(f"{place.name}.py"), False)):
            if file in self._texts:
                found = ModuleSpec(name, self, origin=str(file), is_package=package)
                found.has_location = True
                return found
        if any(file.is_relative_to(place) for file in self._texts):  # a folder without __init__.py
            return ModuleSpec(name, None, is_package=True)
        return None

    def exec_module(self, module: ModuleType) -> None:
        """Run its text."""
        file = str(module.__file__)
        exec(compile(self._texts[Path(file)], file, "exec"), module.__dict__)
