"""Participants' codes: what may be one, which is free next, and a name for files and tables that is safe everywhere."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable, Mapping
from hashlib import sha256

from haptorb.apps.asking.codes import fold_spelling, suggest_code
from haptorb.errors import InputError, quote

__all__ = ["check_code", "is_reserved", "make_labels", "next_code"]

_LONGEST = 16  #: of a code [characters]; columns of databases are made for it
_RESERVED = re.compile(r"s[1i]m-?[0-9]+")  #: in folded spelling


def check_code(code: str) -> str:
    """`code` as it was typed; InputError if it is none. Nothing of it is changed: another spelling is refused.

    Letters of any script, digits, `-`, `_` and `.`; first a letter or digit; at least one digit, so that no bare name
    slips in.

    >>> check_code("P01"), check_code("vp-7"), check_code("Ω_3b")
    ('P01', 'vp-7', 'Ω_3b')
    """
    known = unicodedata.normalize("NFC", code)  # the same letters, also where accents were typed on their own
    meant = suggest_code(code)
    if known != meant and _is_code(meant):
        raise InputError(
            f"participant code must be typed without spaces and with plain letters and digits: enter '{meant}', if "
            f"that is meant; got {quote(code)}"
        )
    if not _is_code(known) or known != meant:
        raise InputError(
            f"participant code must have 1 to {_LONGEST} letters, digits, '-', '_' or '.', begin with a letter or "
            f"digit and contain a digit, like P01 or vp-7 (never a name); got {quote(code)}"
        )
    return known


def _is_code(text: str) -> bool:
    letters = all(unicodedata.category(letter)[0] in "LNM" or letter in "-_." for letter in text)
    return 1 <= len(text) <= _LONGEST and letters and text[0].isalnum() and any(map(str.isdecimal, text))


def is_reserved(code: str) -> bool:
    """Whether only simulated participants may have `code`: SIM and a number, in any spelling."""
    return _RESERVED.fullmatch(fold_spelling(code)) is not None


def next_code(used: Iterable[str]) -> str:
    """A code that is free: after the newest of people's `used` codes that ends in a number, else P01.

    >>> next_code(["P01", "P02"]), next_code(["P02", "vp-09"]), next_code([]), next_code(["7a", "SIM03"])
    ('P03', 'vp-10', 'P01', 'P01')
    """
    codes = list(used)
    taken = {fold_spelling(code) for code in codes}
    for last in reversed(codes):
        found = re.fullmatch(r"(.*?)([0-9]{1,9})", last)
        if found is None or is_reserved(last):
            continue
        number = int(found[2])
        while True:
            number += 1
            free = f"{found[1]}{number:0{len(found[2])}d}"
            if fold_spelling(free) not in taken:
                break
        if len(free) <= _LONGEST:
            return free
    number = 1
    while fold_spelling(f"P{number:02d}") in taken:
        number += 1
    return f"P{number:02d}"


def make_labels(codes: Iterable[str]) -> Mapping[str, str]:
    """Code → label of ASCII letters and digits only, unlike every other one, in any case: for file names.

    A code that is such a label keeps it; others lose the rest of their characters, and get part of their hash where
    that leaves nothing, or what another one has.

    >>> make_labels(["P01", "S-07", "S07"])
    {'P01': 'P01', 'S-07': 'S07x6f83', 'S07': 'S07'}
    """
    codes = list(codes)
    labels = {code: code for code in codes if code.isascii() and code.isalnum()}
    taken = {label.casefold() for label in labels.values()}
    for code in codes:
        if code in labels:
            continue
        plain = "".join(letter for letter in code if letter.isascii() and letter.isalnum())
        label, more = plain, sha256(code.encode()).hexdigest()
        length = 4
        while not label or label.casefold() in taken:
            label, length = f"{plain}x{more[:length]}", length + 1
        labels[code] = label
        taken.add(label.casefold())
    return {code: labels[code] for code in codes}
