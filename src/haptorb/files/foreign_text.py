"""Text that a file brings with it: shown as it is written, and never as what a terminal, table or system makes of it.

A recording, database or scene may come from anybody. `visible` is for all that is printed, `foreign_text` for one line
of it, `foreign_name` for names of columns, files and members, and `escape_formula` for cells of a table.
`tests/contracts/test_poisoned_files.py` lists the commands that print or write such text, and tries each.
"""

from __future__ import annotations

import re
from pathlib import Path

from haptorb.errors import HaptorbError, quote

__all__ = ["escape_formula", "foreign_name", "foreign_text", "named_file", "visible"]

#: control characters but line feed and tab; marks that turn the direction of writing; separators of lines; surrogates
_HIDDEN = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200b\u200e\u200f\u2028\u2029\u202a-\u202e\u2060-\u2069\ufeff\ud800-\udfff"
    "\U000e0000-\U000e007f]"
)
_CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028\u2029]")
_FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n", "\uff1d", "\uff0b", "\uff0d", "\uff20")
_NUMBER = re.compile(r"[+-]?[0-9]+(\.[0-9]+)?")
_NAME = 64  #: characters of a name


def visible(text: str) -> str:
    r"""`text` with `\x1b` and the like in place of what would act on a terminal, or hide or turn what is read.

    Lines and tabs stay.

    >>> print(visible("a\x1b]52;c;cm0=\x07b"))
    a\x1b]52;c;cm0=\x07b
    """
    return _HIDDEN.sub(lambda found: _spell(found[0]), text)  # safety: text-visible


def _spell(letter: str) -> str:
    number = ord(letter)
    return f"\\x{number:02x}" if number < 0x100 else f"\\u{number:04x}" if number < 0x10000 else f"\\U{number:08x}"


def foreign_text(value: object, most: int = 200) -> str:
    r"""`value` as one visible line of at most `most` characters.

    >>> print(foreign_text("one\ntwo" + "x" * 10, 12))
    one\ntwoxxx…
    """
    text = visible(str(value)[: 8 * most]).replace("\n", "\\n").replace("\t", "\\t")
    return text if len(text) <= most and len(str(value)) <= 8 * most else f"{text[: most - 1]}…"


def foreign_name(value: object) -> str:
    """`value` as a name of a column, a file or a member of an archive: letters, digits, `_`, `-` and single dots.

    >>> foreign_name("ball.place"), foreign_name("../../.bashrc"), foreign_name("=cmd|' /C calc'!A0")
    ('ball.place', 'bashrc', 'cmd_C_calc_A0')
    """
    text = "".join(letter if letter.isalnum() or letter in "_.-" else "_" for letter in str(value)[: 4 * _NAME])
    text = re.sub(r"\.{2,}", ".", re.sub(r"_{2,}", "_", text)).strip("._-")
    return text[:_NAME].rstrip("._-") or "unnamed"


def escape_formula(text: str) -> str:
    """`text` for a cell that no spreadsheet takes for a formula: where it begins like one, `'` stands before it.

    Control characters but line feed and tab are made visible; all else is as it was typed.

    >>> escape_formula("=1+1"), escape_formula("-3"), escape_formula("as it is")
    ("'=1+1", '-3', 'as it is')
    """
    text = _CONTROL.sub(lambda found: _spell(found[0]), text)  # safety: cell-visible
    return f"'{text}" if text.lstrip(" ").startswith(_FORMULA) and not _NUMBER.fullmatch(text) else text


def named_file(name: str, folder: Path, what: str, error: type[HaptorbError]) -> Path:
    """The file `name` that a file in `folder` names: it must lie there or below, links followed.

    Raises `error`, naming `what` it is, for another place: who wrote the file does not choose what is read elsewhere.
    """
    try:
        root = folder.resolve()
        found = (root / name).resolve()
        inside = found.is_relative_to(root)
        found.exists()  # raises for a name that is too long
    except (OSError, ValueError, RuntimeError) as cause:  # a zero byte, or links in a circle
        raise error(f"{what} {quote(name)}: not the name of a file") from cause
    if not inside:  # safety: named-inside
        raise error(f"{what} {quote(name)}: is not read, as it lies outside {root}; copy it there")
    return found
