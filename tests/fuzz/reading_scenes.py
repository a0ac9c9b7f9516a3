"""Scenes that MuJoCo reads a file outside of their folder for, if it gets them as they are.

The files outside are valid: only a scene whose file was read is compiled.
"""

from __future__ import annotations

import os
import struct
import zipfile
import zlib
from pathlib import Path

__all__ = ["READING", "make_reading_scene", "write_outside"]

_BODY = "<worldbody><body name='peg'><freejoint/><geom size='0.01'/></body></worldbody>"
_FIELD = "<asset><hfield name='h' size='1 1 1 1' file='{}'/></asset>"
_TEXTURE = "<asset><texture name='t' type='2d' file='{}'/></asset>"
_MODEL = (
    "<mujoco><asset><model name='sub' file='{}'/></asset><worldbody><frame><attach model='sub' body='peg' prefix='p'/>"
    "</frame><body name='peg'><freejoint/><geom size='0.01'/></body></worldbody></mujoco>"
)

#: form → (scene, included file, text of that); OUT is the absolute path outside
READING: dict[str, tuple[str, str, str]] = {
    "include of another suffix": (
        "<mujoco><include file='inner.txt'/></mujoco>", "inner.txt",
        f"<mujoco>{_TEXTURE.format('../outside/t.png')}{_BODY}</mujoco>",
    ),
    "include in a namespace": (
        "<mujoco><include xmlns='a' file='inner.xml'/></mujoco>", "inner.xml",
        f"<mujoco>{_FIELD.format('OUT/h.bin')}{_BODY}</mujoco>",
    ),
    "pipe behind an include": (
        "<mujoco><include file='pipe.txt'/></mujoco>", "pipe.txt",
        f"<mujoco>{_FIELD.format('OUT/pipe')}{_BODY}</mujoco>",
    ),
    "archive": (
        _MODEL.format("x.mjz"), "x.mjz", f"<mujoco model='x'>{_FIELD.format('OUT/h.bin')}{_BODY}</mujoco>",
    ),
    "file with backslashes": (
        f"<mujoco>{_FIELD.format(chr(92).join(('..', 'outside', 'h.bin')))}{_BODY}</mujoco>", "", "",
    ),
    "texture with backslashes": (
        f"<mujoco>{_TEXTURE.format(chr(92).join(('..', 'outside', 't.png')))}{_BODY}</mujoco>", "", "",
    ),
    "folder with backslashes": (
        f"<mujoco><compiler meshdir='..{chr(92)}outside'/>{_FIELD.format('h.bin')}{_BODY}</mujoco>", "", "",
    ),
}  # fmt: skip


def write_outside(folder: Path) -> None:
    """Write a height field, a texture and a pipe to `folder`."""
    folder.mkdir(exist_ok=True)
    (folder / "h.bin").write_bytes(struct.pack("<2i4f", 2, 2, 0.0, 1.0, 2.0, 3.0))
    (folder / "t.png").write_bytes(_make_png())
    os.mkfifo(folder / "pipe")


def _make_png() -> bytes:
    """One red point."""
    chunks = (
        (b"IHDR", struct.pack(">2I5B", 1, 1, 8, 2, 0, 0, 0)), (b"IDAT", zlib.compress(b"\0\xff\0\0")), (b"IEND", b""),
    )  # fmt: skip
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in chunks
    )


def make_reading_scene(form: str, folder: Path, outside: Path, name: str = "reading.xml") -> Path:
    """Write the scene of `form` to `folder`, beside which `outside` lies; return its path."""
    text, inner, content = READING[form]
    content = content.replace("OUT", str(outside))
    if inner.endswith(".mjz"):
        with zipfile.ZipFile(folder / inner, "w") as archive:
            archive.writestr("x.xml", content)
    elif inner:
        (folder / inner).write_text(content)
    path = folder / name
    path.write_text(text.replace("OUT", str(outside)))
    return path
