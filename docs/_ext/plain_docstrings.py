"""Docstrings of this project are plain text; this turns them into what Sphinx reads.

A docstring is written to be read in the source: paragraphs, aligned columns, equations in Unicode, `code` in single
backticks, doctests. Nothing in it is markup, so |F|, m* or x_ mean themselves. Here paragraphs are escaped, doctests
are kept, and whatever is aligned or indented is kept as it stands. Public names have sections after the numpydoc
standard (Parameters, Returns, Raises, Notes, Examples), which Napoleon renders.
"""

from __future__ import annotations

import re
from textwrap import dedent, indent
from typing import Any

from sphinx.application import Sphinx
from sphinx.ext.napoleon import Config
from sphinx.ext.napoleon.docstring import NumpyDocstring

#: what reStructuredText would read as markup
_MARKUP = re.compile(r"([\\*|_<>])")
_CODE = re.compile(r"``?([^`]+)``?")
_ALIGNED = re.compile(r"\S {2,}\S")
_BULLET = re.compile(r"- |\d+\. ")
#: sections of numpydoc: of entries, `name : type` with a text indented below, and of text
_ENTRIES = ("Parameters", "Other Parameters", "Attributes", "Returns", "Yields", "Raises", "Warns")
_TEXTS = ("Notes", "Examples", "References", "Warnings")
# Types are text, such as "array_like, shape (n, 3)": Sphinx would look up every word of a `:type:` field.
_NUMPYDOC = Config(
    napoleon_use_param=False, napoleon_use_rtype=False, napoleon_custom_sections=[("Attributes", "params_style")]
)


def _paragraph(lines: list[str]) -> list[str]:
    text = "\n".join(lines)
    parts, end = [], 0
    for code in _CODE.finditer(text):
        parts += [_MARKUP.sub(r"\\\1", text[end : code.start()]), f"``{' '.join(code[1].split())}``\\ "]
        end = code.end()
    parts.append(_MARKUP.sub(r"\\\1", text[end:]))
    escaped = "".join(parts)
    return [line if number else re.sub(r"^(?!``)(\W|\w[.)]\s|\w+[.)]\s)", r"\\\1", line)
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


def _split_sections(docstring: list[str]) -> list[tuple[str, list[str]]]:
    """(heading, lines) of each section of a numpydoc docstring; the summary has no heading."""
    sections: list[tuple[str, list[str]]] = [("", [])]
    for line, below in zip(docstring, [*docstring[1:], ""], strict=False):
        if line in (*_ENTRIES, *_TEXTS) and below == "-" * len(line):
            sections.append((line, []))
        elif not sections[-1][0] or sections[-1][1] or line != "-" * len(sections[-1][0]):
            sections[-1][1].append(line)
    return sections


def _entries(lines: list[str]) -> list[str]:
    """Entries as they stand, their texts as reStructuredText."""
    out: list[str] = []
    text: list[str] = []
    for line in [*lines, "end"]:
        if line.startswith(" ") or not line.strip():
            text.append(line)
            continue
        out += indent("\n".join(_text(dedent("\n".join(text)).splitlines())), "    ").splitlines()
        text = []
        out.append(line)
    return out[:-1]


def converted(docstring: list[str]) -> list[str]:
    """The lines of a docstring as reStructuredText."""
    sections = _split_sections(docstring)
    if len(sections) == 1:
        return _text(docstring)
    out: list[str] = []
    for heading, lines in sections:
        out += [heading, "-" * len(heading)] if heading else []
        out += _entries(lines) if heading in _ENTRIES else _text(lines)
        out.append("")
    return NumpyDocstring(out, _NUMPYDOC).lines()


def _text(docstring: list[str]) -> list[str]:
    """The lines of plain text as reStructuredText."""
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


_ALIAS = re.compile(r"TypeAliasForwardRef\('(\w+)'\)")


def _name_aliases(
    app: Sphinx, what: str, name: str, obj: object, options: Any, signature: str | None, result: str | None
) -> tuple[str | None, str | None]:
    """`Array` in a union or a tuple, as it is written everywhere else."""
    return tuple(text and _ALIAS.sub(r"\1", text) for text in (signature, result))  # type: ignore[return-value]


def setup(app: Sphinx) -> dict[str, Any]:
    """Hook into autodoc."""
    app.connect("autodoc-process-docstring", _process)
    app.connect("autodoc-process-signature", _name_aliases)
    return {"parallel_read_safe": True}
