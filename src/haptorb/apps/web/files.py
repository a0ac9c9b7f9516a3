"""The files of built pages, in memory: they are small, and nothing waits for a disk while a hand is on the device."""

from __future__ import annotations

from pathlib import Path

from starlette.responses import Response

__all__ = ["page_files", "respond"]

_KINDS = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".svg": "image/svg+xml",
    ".txt": "text/plain; charset=utf-8",
}


def page_files(folder: Path) -> dict[str, tuple[bytes, str]]:
    """Name → (content, media type) of every file in `folder` that a page may ask for; empty if nothing was built."""
    return {path.name: (path.read_bytes(), _KINDS[path.suffix]) for path in folder.glob("*") if path.suffix in _KINDS}


def respond(files: dict[str, tuple[bytes, str]], name: str) -> Response:
    """The file `name`, or that there is none."""
    if name not in files:
        return Response("there is no such file\n", status_code=404, media_type="text/plain")
    content, kind = files[name]
    return Response(content, media_type=kind)
