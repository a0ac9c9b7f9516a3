"""Docstrings of this project are plain text; this turns them into what Sphinx reads.

A docstring is written to be read in the source: paragraphs, aligned columns, equations in Unicode, `code` in single
backticks, doctests. Nothing in it is markup, so |F|, m* or x_ mean themselves. Here paragraphs are escaped, doctests
are kept, and whatever is aligned or indented is kept as it stands.
"""

from __future__ import annotations

import re
from typing import Any

from sphinx.application import Sphinx

#: what reStructuredText would read as markup
_MARKUP = re.compile(r"([\\*|_<>])")
_CODE = re.compile(r"``?([^`]+)``?")
_ALIGNED = re.compile(r"\S {2,}\S")
_BULLET = re.compile(r"- |\d+\. ")


def _paragraph(lines: list[str]) -> list[str]:
    text = "\n".join(lines)
    parts, end = [], 0
    for code in _CODE.finditer(text):
        parts += [_MARKUP.sub(r"\\\1", text[end : code.start()]), f"``{' '.join(code[1].split())}``\\ "]
        end = code.end()
    parts.append(_MARKUP.sub(r"\\\1", text[end:]))
    escaped = "".join(parts)
    return [line if number else re.sub(r"^(\W|\w[.)]\s|\w+[.)]\s)", r"\\\1", line)
            for number, line in enumerate(escaped.splitlines())]  # fmt: skip


def _aligned(line: str) -> bool:
    return _ALIGNED.search(line) is not None


def _as_it_stands(lines: list[str]) -> list[str]:
    return ["::", "", *("   " + line for line in lines)]


def _items(lines: list[str]) -> list[str]:
    items: list[list[str]] = []
    for line in lines:
        if bullet := _BULLET.match(line):
            items.append([line[bullet.end() :]])
        else:
            items[-1].append(line.strip())
    mark = "- " if lines[0].startswith("-") else "#. "
    indent = " " * len(mark)
    return [(indent if number else mark) + line for item in items for number, line in enumerate(_paragraph(item))]


def converted(docstring: list[str]) -> list[str]:
    """The lines of a plain docstring as reStructuredText."""
    blocks: list[list[str]] = [[]]
    for line in docstring:
        if line.strip():
            blocks[-1].append(line.rstrip())
        elif blocks[-1]:
            blocks.append([])
    out: list[str] = []
    for block in filter(None, blocks):
        if block[0].lstrip().startswith(">>>"):
            out += block
        elif _BULLET.match(block[0]):
            out += _items(block)
        elif any(line.startswith(" ") for line in block) or 2 * sum(map(_aligned, block)) > len(block):
            out += _as_it_stands(block)
        else:
            out += _paragraph(block)
        out.append("")
    return out


def _process(app: Sphinx, what: str, name: str, obj: object, options: Any, lines: list[str]) -> None:
    lines[:] = converted(lines)


def setup(app: Sphinx) -> dict[str, Any]:
    """Hook into autodoc."""
    app.connect("autodoc-process-docstring", _process)
    return {"parallel_read_safe": True}
