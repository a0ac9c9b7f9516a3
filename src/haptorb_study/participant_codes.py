"""Participant codes: validation, next free code, confusable spellings, labels for files and tables."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable, Mapping
from hashlib import sha256

from haptorb.errors import InputError, quote

__all__ = [
    "check_code",
    "find_other_spelling",
    "fold_spelling",
    "is_reserved",
    "make_labels",
    "next_code",
    "suggest_code",
]


# --------------------------------------------------------------------------------------------------
# Confusable spellings of codes.


#: Greek and Cyrillic letters that look like Latin ones
_LATIN_LOOK_ALIKES = str.maketrans(
    "\u0391\u0392\u0395\u0396\u0397\u0399\u039a\u039c\u039d\u039f\u03a1\u03a4\u03a5\u03a7"
    "\u03f9\u0408\u03b1\u03bf\u03bd\u03c1\u03c5\u0445\u0410\u0412\u0415\u0405\u0406\u0408"
    "\u041a\u041c\u041d\u041e\u0420\u0421\u0422\u0423\u0425\u04ae\u051a\u051c\u0430\u0435"
    "\u043e\u0440\u0441\u0443\u0445\u0456\u0458\u0455\u04bb\u0501\u051b\u051d",
    "ABEZHIKMNOPTYXCJaovpuxABESIJKMHOPCTYXYQWaeopcyxijshdqw",
)
_DIGIT_LOOK_ALIKES = str.maketrans("OoIl", "0011")
_SEPARATORS = re.compile(r"[\s_.\u2010\u2011\u2012–—−-]+")
_ZEROS = re.compile(r"(?<![0-9])0+(?=[0-9])")


def fold_spelling(code: str) -> str:
    """`code` without confusable differences: case, look-alike letters, O and 0, I, l and 1, separators, leading zeros.

    >>> fold_spelling("P01") == fold_spelling("p01") == fold_spelling("\u04201") == fold_spelling("PO1")
    True
    >>> fold_spelling("1-11") == fold_spelling("11-1")
    False
    """
    plain = unicodedata.normalize("NFKC", code).translate(_LATIN_LOOK_ALIKES).translate(_DIGIT_LOOK_ALIKES).casefold()
    return _ZEROS.sub("", _SEPARATORS.sub("-", plain).strip("-"))


def find_other_spelling(code: str, taken: Iterable[str]) -> str | None:
    """The code among `taken` that differs from `code` only in spelling: case, look-alikes, zeros, separators."""
    folded = (fold_spelling(code), code.casefold())
    return next(
        (one for one in taken if one != code and (fold_spelling(one) == folded[0] or one.casefold() == folded[1])), None
    )


def suggest_code(typed: str) -> str:
    """`typed` without spaces and with plain digits and letters."""
    return "".join(unicodedata.normalize("NFKC", typed).split())


_MAX_CODE_LENGTH = 16  #: of a code [characters]; the databases' columns have this width
_RESERVED = re.compile(r"s[1i]m-?[0-9]+")  #: in folded spelling


def check_code(code: str) -> str:
    """Validate `code`; InputError if it is invalid. It is never changed: another spelling is refused.

    Letters of any script, digits, `-`, `_` and `.`; first a letter or digit; at least one digit, which excludes
    plain names.

    >>> check_code("P01"), check_code("vp-7"), check_code("Ω_3b")
    ('P01', 'vp-7', 'Ω_3b')
    """
    known = unicodedata.normalize("NFC", code)  # composed accents
    meant = suggest_code(code)
    if known != meant and _is_code(meant):
        raise InputError(
            f"participant code must be typed without spaces and with plain letters and digits: enter '{meant}', if "
            f"that is meant; got {quote(code)}"
        )
    if not _is_code(known) or known != meant:
        raise InputError(
            f"participant code must have 1 to {_MAX_CODE_LENGTH} letters, digits, '-', '_' or '.', begin with a letter "
            f"or digit and contain a digit, like P01 or vp-7 (never a name); got {quote(code)}"
        )
    return known


def _is_code(text: str) -> bool:
    letters = all(unicodedata.category(letter)[0] in "LNM" or letter in "-_." for letter in text)
    return 1 <= len(text) <= _MAX_CODE_LENGTH and letters and text[0].isalnum() and any(map(str.isdecimal, text))


def is_reserved(code: str) -> bool:
    """Whether `code` is reserved for simulated participants: SIM and a number, in any spelling."""
    return _RESERVED.fullmatch(fold_spelling(code)) is not None


def next_code(used: Iterable[str]) -> str:
    """Next free code: after the newest used one that ends in a number, else P01.

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
        if len(free) <= _MAX_CODE_LENGTH:
            return free
    number = 1
    while fold_spelling(f"P{number:02d}") in taken:
        number += 1
    return f"P{number:02d}"


def make_labels(codes: Iterable[str]) -> Mapping[str, str]:
    """Code → unique label of ASCII letters and digits, also without case, for file names.

    A code that is such a label is unchanged; other characters are removed, and part of the code's hash is appended
    where the result is empty or not unique.

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
