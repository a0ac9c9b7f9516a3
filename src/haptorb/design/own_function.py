"""A user's own objective: `mine.py:cost`, a function of a candidate that returns a number. Its code travels along."""

from __future__ import annotations

import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

from haptorb.errors import InputError, UnknownName
from haptorb.files.file_kind import FileKind
from haptorb.files.own_imports import find_imports, list_modules
from haptorb.files.text_file import read_text

__all__ = ["load_function", "split_function"]

_modules: dict[Path, tuple[str, ModuleType]] = {}


def split_function(text: str, folder: Path) -> tuple[Path, str]:
    """File and name in "file.py:name"; a relative path starts at `folder`. InputError for anything else.

    >>> split_function("mine.py:cost", Path("/designs"))
    (PosixPath('/designs/mine.py'), 'cost')
    """
    path, found, name = text.rpartition(":")
    if not found or not path.endswith(".py") or not name.isidentifier():
        raise InputError(f"function must be 'file.py:name'; got '{text}'")
    return folder / Path(path).expanduser(), name


def load_function(
    text: str, folder: Path, announce: Callable[[Path, str], None] = lambda path, name: None
) -> tuple[Callable[..., Any], str]:
    """The function that "file.py:name" names, and the text of its file and of what that imports from beside it.

    The file is run once; `announce` receives it, and the name, before that. Raises InputError, with file and line, if
    it cannot be read or fails, UnknownName if it has no such function.
    """
    path, name = split_function(text, folder)
    source = read_text(path, "file of an objective", InputError, kind=FileKind.WORLD)
    known = _modules.get(path)
    if known is not None and known[0] == source:
        module = known[1]
    else:
        announce(path, name)
        module = _run(path, source)
    _modules[path] = (source, module)
    beside = find_imports(path, source)
    _send_along(module, *list_modules(beside))
    function = vars(module).get(name)
    if not callable(function):
        names = [key for key, value in vars(module).items() if callable(value) and not key.startswith("_")]
        raise UnknownName(f"function in {path}", name, names)
    return function, "\0".join((source, *beside.values()))


def _send_along(*modules: ModuleType) -> None:
    """Other processes and machines need not have the files of `modules`."""
    import cloudpickle

    for module in modules:
        cloudpickle.register_pickle_by_value(module)


def _run(path: Path, source: str) -> ModuleType:
    module = ModuleType(f"haptorb_objective_{path.stem}")
    module.__file__ = str(path)
    if str(path.parent) not in sys.path:
        sys.path.append(str(path.parent))  # for modules beside it; last, so that they hide nothing
    sys.modules[module.__name__] = module  # dataclasses look for it there
    try:
        exec(compile(source, str(path), "exec"), module.__dict__)
    except BaseException as cause:  # the user's code: also sys.exit
        if isinstance(cause, KeyboardInterrupt):
            raise
        frames = [one for one in traceback.extract_tb(cause.__traceback__) if one.filename == str(path)]
        line = frames[-1].lineno if frames else getattr(cause, "lineno", None)
        where = f", line {line}" if line else ""
        raise InputError(f"objective's file {path}{where}: {type(cause).__name__}: {cause}") from cause
    return module
