"""Validation of a scene's XML before MuJoCo parses it: the files that it names, and the size of the result.

MuJoCo opens any path and creates any number of bodies for `<replicate>`. Scenes are untrusted: the files that they name
must be regular ones of bounded size in their own folder or below, and the number of elements is bounded. MuJoCo gets
the bytes that were checked, not the names of the files (`scene_compiler.py`).

Names are read as MuJoCo reads them: elements in any case (`<Include>`), `a/../b` as `b` whatever `a` is, without
`package://`, and without folders if `strippath` is set.
"""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import dataclass, field
from math import prod
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from haptorb.errors import InputError, quote
from haptorb.file_kind import FileKind
from haptorb.files import named_file, read_bytes, read_text

__all__ = ["check_scene_file", "list_scene_files"]

_ELEMENTS = 20_000  #: maximum number, including all repetitions
_FILES = 200
_NAMES = 10_000  #: maximum number of places where files are looked for
_BYTES = 256 * 1024 * 1024  #: maximum size of all files together
_PIXELS = 4096 * 4096  #: maximum size of a generated texture
_CELLS = 2048 * 2048  #: maximum size of a height field without a file
_MAX_DEPTH = 90  #: maximum nesting depth, repeated files included; MuJoCo's parser has 100
_XML = ("include", "model")  #: elements whose file is itself a scene
_XML_ENDS = (".xml", ".mjcf", ".urdf")  #: suffixes of such files
_FOLDERS = ("meshdir", "texturedir", "assetdir")  #: attributes of the compiler


def check_scene_file(path: Path, assets: Path | None = None) -> dict[str, bytes]:
    """Return the content of the scene in the file `path` and of all files that it names, by the absolute paths under
    which MuJoCo asks for them; the first is the scene's.

    assets  folder within which it may name files; by default its own

    Raises InputError if it names a file that must not be read, or is too large. MuJoCo reports other errors.
    """
    path = Path(os.path.abspath(path))
    found = _SceneCheck(path.parent, assets)
    found.check(path)
    return {name: found.files[place] for name, place in found.names.items()}


def list_scene_files(path: Path, assets: Path | None = None) -> tuple[Path, ...]:
    """List the scene in the file `path` and every file that it names, directly or indirectly, including missing ones;
    as far as it can be parsed."""
    found = _SceneCheck(Path(os.path.abspath(path.parent)), assets)
    with suppress(InputError):
        found.check(path)
    own = path.resolve()
    return (path, *sorted({*found.files, *found.missing} - {path, own}))


class _Place(NamedTuple):
    """Where an element stands.

    path     its file
    home     folder of the scene or submodel that it belongs to, to which `meshdir` and the like are relative
    folders  those in which MuJoCo may search a file that it names
    above    the files that include this one
    """

    path: Path
    home: Path
    folders: tuple[Path, ...]
    above: tuple[Path, ...] = ()


@dataclass
class _SceneCheck:
    """Validation of one scene; `folder` is its own, `assets` the one within which it may name files, if different."""

    folder: Path
    assets: Path | None = None
    files: dict[Path, bytes] = field(default_factory=dict)  #: content of each file
    names: dict[str, Path] = field(default_factory=dict)  #: path in MuJoCo's form → file
    missing: set[Path] = field(default_factory=set)
    size: int = 0
    #: (XML file, home) → number of its elements, with all included files
    counted: dict[tuple[Path, Path], int] = field(default_factory=dict)
    looked: int = 0  #: number of places where files were looked for
    strips: bool = False  #: whether the folders in a file's name are ignored
    lost: list[str] = field(default_factory=list)  #: names of files that are nowhere

    def check(self, path: Path) -> None:
        place = path.resolve()
        self.names[str(path)] = place
        root = self._parse(path, place)
        self._count(root, _Place(path, self.folder, self._list_folders(root, self.folder)))
        known = {name.rpartition("/")[2].lower() for name in self.names}
        for text in self.lost:
            if text.rpartition("/")[2].lower() in known:  # MuJoCo would take the file of that name in another folder
                raise InputError(f"file of a scene {quote(text)}: does not exist")

    def _count(self, root: Element, where: _Place) -> int:
        """Number of elements of a file's `root` including repetitions. Iterative: XML may be nested deeply."""
        total, path = 0, where.path
        waiting: list[tuple[Element, int, int]] = [(root, 1, 1)]
        while waiting:
            element, times, depth = waiting.pop()
            if depth + 10 * len(where.above) > _MAX_DEPTH:
                raise InputError(f"scene {path}: elements are nested too deep")
            times = min(times * _repetitions(element), 10**12)
            total += times * (1 + self._check_element(element, where))
            if total > _ELEMENTS:  # safety: scene-elements
                raise InputError(f"scene {path} makes {_round(total)} elements; at most {_ELEMENTS} are possible")
            waiting += [(child, times, depth + 1) for child in element]
        return total

    def _check_element(self, element: Element, where: _Place) -> int:
        """Check the files that one element names; return the number of elements of an included file."""
        tag = _plain(element.tag)
        for name, most in (("texture", _PIXELS), ("hfield", _CELLS)):
            sides = ("width", "height") if name == "texture" else ("nrow", "ncol")
            if tag == name and prod(_number(element.get(side, "0")) for side in sides) > most:
                raise InputError(f"scene {where.path}: a {name} of more than {most} cells; make it smaller")
        inside = 0
        for key, text in element.attrib.items():
            if _plain(key).startswith("file") and text.strip():
                inside = max(inside, self._check_name(tag, text, where))
        return inside

    def _check_name(self, tag: str, text: str, where: _Place) -> int:
        """Check the file `text` that an element `tag` names; return the number of elements of an included file."""
        is_xml, inside, exists = tag in _XML, 0, False
        for folder in where.folders:
            for name in _spellings(text, strips=self.strips and not is_xml):
                wanted, place = self._find(name, folder, "file of a scene")
                if is_xml and not name.lower().endswith(_XML_ENDS):
                    raise InputError(
                        f"file of a scene {quote(text)}: is not read; a scene includes {', '.join(_XML_ENDS)} only"
                    )
                if not place.exists():
                    if len(self.missing) < _FILES:
                        self.missing.add(place)
                    continue
                exists = True
                self.names[str(wanted)] = place
                if is_xml:
                    inside = max(inside, self._count_file(tag, place, where))
                else:
                    self._add(place)
        if not exists:
            self.lost.append(text)
        return inside

    def _count_file(self, tag: str, place: Path, where: _Place) -> int:
        if place in where.above:
            raise InputError(f"scene {place} includes itself")
        home = place.parent if tag == "model" else where.home
        if (place, home) not in self.counted:
            root = self._parse(place, place)
            folders = dict.fromkeys((place.parent, *where.folders, *self._list_folders(root, home)))
            inner = _Place(place, home, tuple(folders), (*where.above, place))
            self.counted[place, home] = self._count(root, inner)
        return self.counted[place, home]

    def _list_folders(self, root: Element, home: Path) -> tuple[Path, ...]:
        """Folders in which MuJoCo may search a file that the scene or submodel in `home` names."""
        found = [home]
        self.strips |= _plain(root.tag) == "robot"
        for compiler in root.iter():
            if _plain(compiler.tag) != "compiler":
                continue
            self.strips |= compiler.get("strippath") == "true"
            for key, text in compiler.attrib.items():
                if _plain(key) in _FOLDERS and text:
                    found.append(self._find(text, home, f"{_plain(key)} of a scene")[0])
        return tuple(dict.fromkeys(found))

    def _find(self, text: str, folder: Path, what: str) -> tuple[Path, Path]:
        """Path by which MuJoCo asks for `text` in `folder`, and the file there, links resolved."""
        self.looked += 1
        if self.looked > _NAMES:
            raise InputError(f"the scene names files at more than {_NAMES} places; use fewer names or folders")
        if "\\" in text or ":/" in text:  # safety: plain-names
            raise InputError(f"{what} {quote(text)}: is not read; write a path with / and without \\ and :/")
        remedy = f"copy it there, or allow a folder that has both: --assets {quote(str(folder.parent))}"
        wanted = os.path.normpath(folder / text)
        return Path(wanted), named_file(wanted, folder, what, InputError, self.assets or self.folder, remedy)

    def _add(self, place: Path) -> None:
        if place not in self.files:
            self._keep(place, read_bytes(place, _BYTES, "file of a scene", InputError))

    def _parse(self, path: Path, place: Path) -> Element:
        """Parse the scene in the file `path`, which is `place`, and keep the text that was parsed."""
        text = read_text(path, "scene", InputError, 8 * 1024 * 1024, FileKind.SCENE)
        if "<!DOCTYPE" in text or "<!ENTITY" in text:
            raise InputError(f"scene {path}: has a document type declaration, which scenes do not need; remove it")
        try:
            root = ElementTree.fromstring(text)
        except (ElementTree.ParseError, ValueError, RecursionError) as cause:
            line = cause.position[0] if isinstance(cause, ElementTree.ParseError) else 1
            raise InputError(f"scene {path}, line {line}: is not XML ({quote(str(cause), 200)[1:-1]})") from cause
        self._keep(place, text.encode())
        return root

    def _keep(self, place: Path, content: bytes) -> None:
        # MuJoCo would read scenes in an archive, which nobody checked.
        if content.startswith(b"PK"):  # safety: no-archive
            raise InputError(f"file of a scene {quote(place.name)}: is an archive, which is not read; unpack it")
        self.size += len(content) - len(self.files.get(place, b""))
        self.files[place] = content
        if len(self.files) > _FILES or self.size > _BYTES:
            raise InputError(
                f"the files of scene {quote(place.name)} are too many or too large; at most {_FILES} and "
                f"{_BYTES >> 20} MB are read"
            )


def _plain(name: str) -> str:
    """Name of an element or attribute as MuJoCo compares it: without a namespace, in lower case."""
    return name.rpartition("}")[2].lower()


def _spellings(text: str, *, strips: bool) -> list[str]:
    """Names by which MuJoCo may look for the file `text`."""
    text = text.removeprefix("package://")
    return list(dict.fromkeys([text, text.rpartition("/")[2]])) if strips else [text]


def _repetitions(element: Element) -> int:
    if _plain(element.tag) not in ("replicate", "composite", "flexcomp", "grid"):
        return 1
    counts = element.get("count", "1").split()
    return max(1, prod(_number(one) for one in counts[:3]))


def _number(text: str) -> int:
    """Non-negative count; MuJoCo rejects anything else."""
    try:
        return max(0, min(int(float(text)), 10**9))
    except (ValueError, OverflowError):
        return 10**9 if text.strip().lower().lstrip("+").startswith("inf") else 1


def _round(number: int) -> str:
    return f"{number:.0e}" if number > 10**7 else str(number)
