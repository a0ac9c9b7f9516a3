"""Python files of users: the modules that they import from their folder, and objects pickled with their code."""

from __future__ import annotations

import ast
import io
import os
import re
import sys
from codecs import lookup
from collections.abc import Iterator
from importlib.util import decode_source
from pathlib import Path
from tokenize import detect_encoding
from types import CodeType, ModuleType
from typing import Any

from haptorb.errors import InputError
from haptorb.files import read_bytes

__all__ = ["find_imports", "list_modules", "make_code", "pickle_with_code"]


# --------------------------------------------------------------------------------------------------
# Imports of a user's Python file from its own folder, found by parsing, without executing it.


_MAX_FILES = 500  #: modules of one file
_MAX_BYTES = 4 << 20  #: of all these modules together; parsing takes 1 s per 2 MB
_MAX_NAME_PARTS = 40  #: parts of a dotted name: Python's parser takes time with their square
#: What Python skips between two parts. To its parser a line ends at any of CR, LF and CR LF.
_BETWEEN = r"(?:[ \t\f]|\\(?:\r\n?|\n))*+"
_LETTER = r"[\w\x80-\U0010ffff]"  #: Python's names may have characters that are no letters to `re`
#: encodings of host names: decoding takes time with the square of the length
_SLOW_ENCODINGS = ("punycode", "idna")
_DOTTED = re.compile(rf"(?<!{_LETTER})(?:{_LETTER}++{_BETWEEN}\.{_BETWEEN}){{{_MAX_NAME_PARTS}}}")


def find_imports(path: Path, source: str) -> dict[Path, str]:
    """Return file → text of every module in the folder of `path`, and below it, that `source`, its text, imports:
    directly or through others, at the top or within a function. `path` itself is not among them.

    Raises InputError for more than 500 modules, for more than 4 MiB of them, for one that cannot be read, and for a
    name of more than 40 parts.
    """
    found: dict[Path, str] = {}
    waiting, left = [(path, source)], _MAX_BYTES
    while waiting:
        at, text = waiting.pop()
        for file in _list_files(at, text, path.parent):
            if file == path or file in found:
                continue
            if len(found) >= _MAX_FILES:
                raise InputError(f"{path} imports more than {_MAX_FILES} modules of its folder")
            content = read_bytes(file, _MAX_BYTES, f"module of {path.name}", InputError)  # safety: imports-have-an-end
            left -= len(content)
            if left < 0:  # safety: imports-end-together
                raise InputError(f"{path} imports more than {_MAX_BYTES >> 20} MiB of modules of its folder")
            found[file] = _decode(content)
            waiting.append((file, found[file]))
    return dict(sorted(found.items()))


def _decode(content: bytes) -> str:
    """The text that Python reads: without a byte order mark, in the encoding that the first lines name."""
    try:
        encoding, _ = detect_encoding(io.BytesIO(content).readline)
        if lookup(encoding).name not in _SLOW_ENCODINGS:
            text = decode_source(content)
            text.encode()  # some encodings make halves of characters, of which there is no digest
            return text
    except (SyntaxError, ValueError, LookupError):  # Python reports it better, at the import itself
        pass
    return content.decode("utf-8", "replace")


def list_modules(files: dict[Path, str]) -> list[ModuleType]:
    """Return the modules of this process that were imported from `files`."""
    paths = {str(path) for path in files}
    return [one for one in list(sys.modules.values()) if getattr(one, "__file__", None) in paths]


def _list_files(path: Path, text: str, folder: Path) -> Iterator[Path]:
    """List the files below `folder` that `text`, of the file `path`, may import."""
    if _DOTTED.search(text):
        raise InputError(f"{path}: a name has more than {_MAX_NAME_PARTS} parts")
    try:
        tree = ast.parse(text)
    except (SyntaxError, ValueError, RecursionError, MemoryError):  # Python reports it better, at the import itself
        return
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield from _resolve(folder, alias.name.split("."))
        elif isinstance(node, ast.ImportFrom):
            start = path.parents[node.level - 1] if 0 < node.level <= len(path.parents) else folder
            if start.is_relative_to(folder):
                parts = node.module.split(".") if node.module else []
                for alias in node.names:
                    yield from _resolve(start, [*parts, alias.name])


def _resolve(folder: Path, parts: list[str]) -> Iterator[Path]:
    """List the files of a dotted name: those of its packages, and the module's."""
    place = folder
    for part in parts:
        place = place / part
        for file in (place.with_name(f"{place.name}.py"), place / "__init__.py"):
            if os.path.isfile(file):  # unlike Path.is_file also false for a name that no file can have
                yield file


# --------------------------------------------------------------------------------------------------
# Pickle objects together with the code that defines them, for processes that do not have its files.


def pickle_with_code(what: object) -> bytes:
    """Pickle `what` with cloudpickle; `pickle.loads` reads it.

    Code objects keep their file name. Cloudpickle 3.1.2 and later replace it, so that an error message could not say
    where in the user's code the error is.
    """
    from cloudpickle import Pickler  # imported late: few commands need it

    reduce_code = Pickler.dispatch_table[CodeType]

    def keep_filename(code: CodeType) -> tuple[Any, tuple[Any, ...]]:
        _, values = reduce_code(code)
        return make_code, (code.co_filename, *values)

    class CodePickler(Pickler):  # type: ignore[misc]  # cloudpickle has no types
        dispatch_table = Pickler.dispatch_table.new_child({CodeType: keep_filename})

    file = io.BytesIO()
    CodePickler(file).dump(what)
    return file.getvalue()


def make_code(filename: str, *values: Any) -> CodeType:
    """Return the code object with the constructor arguments `values`, from the file `filename`."""
    return CodeType(*values).replace(co_filename=filename)
