"""Participants' codes: what may be one, which is free next, and a name for files and tables that is safe everywhere."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable, Mapping
from hashlib import sha256

from haptorb.errors import InputError, quote

__all__ = ["check_code", "fold_code", "is_reserved", "make_labels", "next_code"]

_LONGEST = 16  #: of a code [characters]; columns of databases are made for it
_RESERVED = re.compile(r"sim[0-9]+")


def check_code(code: str) -> str:
    """`code` in its composed form; InputError if it is none.

    Letters of any script, digits, `-`, `_` and `.`; first a letter or digit; at least one digit, so that no bare name
    slips in.

    >>> check_code("P01"), check_code("vp-7"), check_code("Ω_3b")
    ('P01', 'vp-7', 'Ω_3b')
    """
    known = unicodedata.normalize("NFKC", code)
    letters = all(unicodedata.category(letter)[0] in "LNM" or letter in "-_." for letter in known)
    if not (1 <= len(known) <= _LONGEST and letters and known[0].isalnum() and any(map(str.isdecimal, known))):
        raise InputError(
            f"participant code must have 1 to {_LONGEST} letters, digits, '-', '_' or '.', begin with a letter or "
            f"digit and contain a digit, like P01 or vp-7 (never a name); got {quote(code)}"
        )
    return known


def fold_code(code: str) -> str:
    """`code` without the difference of capitals: codes that differ in nothing else are one person's.

    >>> fold_code("P01") == fold_code("p01")
    True
    """
    return unicodedata.normalize("NFKC", code).casefold()


def is_reserved(code: str) -> bool:
    """Whether only simulated participants may have `code`: SIM and a number."""
    return _RESERVED.fullmatch(fold_code(code)) is not None


def next_code(used: Iterable[str]) -> str:
    """A code that is free: after the newest of people's `used` codes that ends in a number, else P01.

    >>> next_code(["P01", "P02"]), next_code(["P02", "vp-09"]), next_code([]), next_code(["7a", "SIM03"])
    ('P03', 'vp-10', 'P01', 'P01')
    """
    codes = list(used)
    taken = {fold_code(code) for code in codes}
    for last in reversed(codes):
        found = re.fullmatch(r"(.*?)([0-9]{1,9})", last)
        if found is None or is_reserved(last):
            continue
        number = int(found[2])
        while True:
            number += 1
            free = f"{found[1]}{number:0{len(found[2])}d}"
            if fold_code(free) not in taken:
                break
        if len(free) <= _LONGEST:
            return free
    number = 1
    while fold_code(f"P{number:02d}") in taken:
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
