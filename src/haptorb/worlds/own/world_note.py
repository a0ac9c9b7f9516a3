"""A world as text, so that a recording can be replayed: package worlds by name and parameters, own code by digest.

Such a text is never executed, and neither is code that it names: a file of own code runs again only if this account
has started just that code by name (`started_code`). Classes of haptorb are created again with their values; a scene's
file is loaded only if it is byte for byte the recorded one.
"""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Mapping
from dataclasses import MISSING, Field, fields, is_dataclass
from importlib import import_module
from pathlib import Path
from types import CodeType
from typing import Any

import numpy as np

from haptorb.errors import HaptorbError, InputError, quote
from haptorb.files.text_file import read_bytes
from haptorb.worlds.own.started_code import find_started
from haptorb.worlds.own.world_file import WorldFile, find_world_file, name_code
from haptorb.worlds.scene.scene_model import SceneModel, make_scene_model
from haptorb.worlds.world import World

__all__ = ["load_noted_world", "note_world"]

_ROOM = "haptorb.worlds."
_DEEPEST = 12
_LONGEST = 16 << 20  #: bytes of a world's or scene's own file
#: of the arrays in a note
_TYPES = frozenset({"<f8", "<f4", "<i8", "<i4", "<i2", "<u8", "<u4", "<u2", "|i1", "|u1", "|b1"})


class _OwnCode(Exception):
    """A value that is a user's code."""


def note_world(world: World) -> str:
    """`world` as JSON: "made" with the values of a world of the package, or "code" with file, name and digest.

    >>> from haptorb.worlds import find_world
    >>> load_noted_world(note_world(find_world("dome")())) == find_world("dome")()
    True
    """
    try:
        return json.dumps({"made": _encode(world)})
    except _OwnCode:
        return json.dumps({"code": _describe_code(world)})


def load_noted_world(text: str) -> World:
    """The world described by `note_world`.

    Raises InputError, with the reason, if this version of haptorb cannot create it, or if the code or scene is
    missing or has changed.
    """
    try:
        note = json.loads(text)
        if "code" in note:
            return _load_code(note["code"])
        world = _decode(note["made"], 0)
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
        return {"scene": str(value.file), "digest": _digest(value.file)}
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
    """Whether a field that is no number, a height map perhaps, has its default."""
    if one.default_factory is MISSING or not isinstance(value, np.ndarray):
        return False
    usual = one.default_factory()
    return isinstance(usual, np.ndarray) and usual.dtype == value.dtype and np.array_equal(usual, value)


def _decode(value: Any, depth: int) -> Any:
    if depth > _DEEPEST:
        raise InputError("it is nested too deeply")
    if not isinstance(value, dict):
        return value
    if "tuple" in value:
        return tuple(_decode(one, depth + 1) for one in value["tuple"])
    if "array" in value:
        if value["dtype"] not in _TYPES:  # safety: noted-arrays-are-numbers
            raise InputError(f"an array of {quote(value['dtype'])} is not numeric")
        shape = tuple(map(int, value["shape"]))
        return np.frombuffer(base64.b64decode(value["array"]), np.dtype(value["dtype"])).reshape(shape).copy()
    if "scene" in value:
        path = Path(value["scene"])
        if _digest(path) != value["digest"]:
            raise InputError(f"the scene {path} has changed, or is missing")
        return make_scene_model(path)
    module, _, name = str(value["kind"]).partition(":")
    if not module.startswith(_ROOM):
        raise InputError(f"{quote(value['kind'])} is not a world of haptorb")
    kind = getattr(import_module(module), name, None)
    if not (isinstance(kind, type) and is_dataclass(kind) and kind.__module__ == module):
        raise InputError(f"{quote(value['kind'])} is not a world of this version of haptorb")
    return kind(**{key: _decode(one, depth + 1) for key, one in value["fields"].items()})


def _digest(path: Path) -> str:
    """Of a regular file of reasonable size; empty for anything else."""
    try:
        return hashlib.sha256(read_bytes(path, _LONGEST, "file of a world", InputError)).hexdigest()
    except InputError:
        return ""


def _describe_code(world: World) -> dict[str, str]:
    """File, name and digest of the code, and whether the file is one that only defines a world."""
    code = getattr(world.wrench_code, "__code__", None)
    file = Path(code.co_filename) if isinstance(code, CodeType) else Path()
    return {
        "file": str(file),
        "name": name_code(world),
        "digest": _digest(file),
        "loaded": "yes" if find_world_file(world) else "",
        "made": repr(world)[:400],
    }


def _load_code(code: Mapping[str, Any]) -> World:
    path, name = Path(str(code["file"])), str(code["name"])
    if not code["digest"]:
        raise InputError(f"its code was not in a file: {quote(code['made'])}")
    if not code["loaded"]:
        raise InputError(f"its code is in the program {path}, which is not executed; use --world FILE.py:NAME")
    if not path.is_file():
        raise InputError(f"its code was in {path}, which is missing")
    if _digest(path) != code["digest"]:
        raise InputError(f"its code in {path} has changed")
    plain = "" if "." in name or "<" in name else name
    texts = find_started(path, name)
    return WorldFile(path, plain).load(texts)
