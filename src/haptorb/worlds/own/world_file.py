"""A world in a user's Python file: `groove.py:Groove`. Only files named at the start are ever loaded."""

from __future__ import annotations

import linecache
import os
import sys
import traceback
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

from haptorb.errors import HaptorbError, InputError, UnknownName
from haptorb.files.file_kind import FileKind
from haptorb.files.text_file import read_text
from haptorb.worlds.own.function_world import make_world
from haptorb.worlds.world import World

__all__ = ["WorldFile", "is_world_file", "parse_world_file"]


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


@dataclass(frozen=True)
class WorldFile:
    """The world `name` in the Python file `path`, with `values` for some of its parameters.

    name   a class of a World, a World, or a function of a State; empty: the only World class that the file defines
    """

    path: Path
    name: str = ""
    values: Mapping[str, Any] = field(default_factory=dict)

    def load(self) -> World:
        """Run the file and return its world.

        Raises InputError if the file cannot be read or fails, with file and line, or has no such world; UnknownName
        and InputError for values that its parameters do not allow.
        """
        module = self._run()
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

    def _run(self) -> ModuleType:
        """The file as a module of its own, known by a name that no other module has."""
        import cloudpickle

        text = read_text(self.path, "world file", InputError, kind=FileKind.WORLD)
        module = ModuleType(f"haptorb_world_{self.path.stem}")
        module.__file__ = str(self.path)
        folder = str(self.path.parent)
        if folder not in sys.path:
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
