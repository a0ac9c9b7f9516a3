"""Validation of a scene's XML before MuJoCo parses it: the files that it names, and the size of the result.

MuJoCo opens any path and creates any number of bodies for `<replicate>`. Scenes are untrusted: the files that they name
must be regular ones of bounded size in their own folder or below, and the number of elements is bounded.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field
from math import prod
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from haptorb.errors import InputError, quote
from haptorb.file_kind import FileKind
from haptorb.files import named_file, open_regular, read_text

__all__ = ["check_scene_file", "list_scene_files"]

_ELEMENTS = 20_000  #: maximum number, including all repetitions
_FILES = 200
_BYTES = 256 * 1024 * 1024  #: maximum size of all files together
_PIXELS = 4096 * 4096  #: maximum size of a generated texture
_CELLS = 2048 * 2048  #: maximum size of a height field without a file
_MAX_DEPTH = 90  #: maximum nesting depth, repeated files included; MuJoCo's parser has 100
_XML = ("include", "model")  #: elements whose file is itself a scene


def check_scene_file(path: Path, assets: Path | None = None) -> None:
    """Raise InputError if the scene in the file `path` names a file that must not be read, or is too large.

    assets  folder within which it may name files; by default its own

    Other errors are reported by MuJoCo.
    """
    _SceneCheck(path.parent, assets).check(path)


def list_scene_files(path: Path, assets: Path | None = None) -> tuple[Path, ...]:
    """List the scene in the file `path` and every file that it names, directly or indirectly, including missing ones;
    as far as it can be parsed."""
    found = _SceneCheck(path.parent, assets)
    with suppress(InputError):
        found.check(path)
    return (path, *sorted({*found.files, *found.missing} - {path}))


@dataclass
class _SceneCheck:
    """Validation of one scene; `folder` is its own, `assets` the one within which it may name files, if different."""

    folder: Path
    assets: Path | None = None
    files: set[Path] = field(default_factory=set)
    missing: set[Path] = field(default_factory=set)
    size: int = 0
    #: number of elements of each XML file, with all included files
    counted: dict[Path, int] = field(default_factory=dict)

    def check(self, path: Path) -> None:
        root = _parse(path)
        folders = self._list_folders(root)
        elements = self._count(root, path, folders, ())
        if elements > _ELEMENTS:
            raise InputError(f"scene {path} makes {_round(elements)} elements; at most {_ELEMENTS} are possible")

    def _count(self, root: Element, path: Path, folders: list[Path], above: tuple[Path, ...]) -> int:
        """Number of elements of a file's `root` including repetitions. Iterative: XML may be nested deeply."""
        total = 0
        waiting: list[tuple[Element, int, int]] = [(root, 1, 1)]
        while waiting:
            element, times, depth = waiting.pop()
            if depth + 10 * len(above) > _MAX_DEPTH:
                raise InputError(f"scene {path}: elements are nested too deep")
            times = min(times * _repetitions(element), 10**12)
            total += times * (1 + self._check_element(element, path, folders, above))
            if total > _ELEMENTS:
                raise InputError(f"scene {path} makes {_round(total)} elements; at most {_ELEMENTS} are possible")
            waiting += [(child, times, depth + 1) for child in element]
        return total

    def _check_element(self, element: Element, path: Path, folders: list[Path], above: tuple[Path, ...]) -> int:
        """Check the files that one element names; return the number of elements of an included file."""
        for name, most in (("texture", _PIXELS), ("hfield", _CELLS)):
            sides = ("width", "height") if name == "texture" else ("nrow", "ncol")
            if element.tag == name and prod(_number(element.get(side, "0")) for side in sides) > most:
                raise InputError(f"scene {path}: a {name} of more than {most} cells; make it smaller")
        inside = 0
        for key, text in element.attrib.items():
            if not key.startswith("file") or not text.strip():
                continue
            for place in dict.fromkeys(self._find(text, folder, "file of a scene") for folder in folders):
                if not place.exists():
                    if len(self.missing) < _FILES:
                        self.missing.add(place)
                    continue
                self._add(place)
                if element.tag in _XML and place.suffix.lower() in (".xml", ".mjcf", ".urdf", ""):
                    inside = max(inside, self._count_file(place, folders, above))
        return inside

    def _count_file(self, place: Path, folders: list[Path], above: tuple[Path, ...]) -> int:
        if place in above:
            raise InputError(f"scene {place} includes itself")
        if place not in self.counted:
            root = _parse(place)
            more = [place.parent, *folders, *self._list_folders(root)]
            self.counted[place] = self._count(root, place, list(dict.fromkeys(more)), (*above, place))
        return self.counted[place]

    def _list_folders(self, root: Element) -> list[Path]:
        """Folders in which MuJoCo may search a file that the scene names."""
        found = [self.folder]
        for compiler in root.iter("compiler"):
            for key in ("meshdir", "texturedir", "assetdir"):
                if compiler.get(key):
                    found.append(self._find(compiler.get(key, ""), self.folder, f"{key} of a scene"))
        return list(dict.fromkeys(found))

    def _find(self, text: str, folder: Path, what: str) -> Path:
        remedy = f"copy it there, or allow a folder that has both: --assets {quote(str(folder.parent))}"
        limit = self.assets or self.folder
        return named_file(text, folder, what, InputError, limit, remedy)

    def _add(self, place: Path) -> None:
        if place in self.files:
            return
        with open_regular(place, "file of a scene", InputError) as file:
            self.size += file.seek(0, 2)
        self.files.add(place)
        if len(self.files) > _FILES or self.size > _BYTES:
            raise InputError(
                f"the files of scene {quote(place.name)} are too many or too large; at most {_FILES} and "
                f"{_BYTES >> 20} MB are read"
            )


def _parse(path: Path) -> Element:
    text = read_text(path, "scene", InputError, 8 * 1024 * 1024, FileKind.SCENE)
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise InputError(f"scene {path}: has a document type declaration, which scenes do not need; remove it")
    try:
        return ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError, RecursionError) as cause:
        line = cause.position[0] if isinstance(cause, ElementTree.ParseError) else 1
        raise InputError(f"scene {path}, line {line}: is not XML ({quote(str(cause), 200)[1:-1]})") from cause


def _repetitions(element: Element) -> int:
    if element.tag not in ("replicate", "composite", "flexcomp", "grid"):
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
