"""When two codes of participants are one code in two spellings, and when a text is no code but was meant as one."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable

__all__ = ["find_other_spelling", "fold_spelling", "suggest_code"]

#: letters that look like Latin ones: Greek and Cyrillic, capitals and small
_ALIKE = str.maketrans(
    "ΑΒΕΖΗΙΚΜΝΟΡΤΥΧϹЈαονρυхАВЕЅІЈКМНОРСТУХҮԚԜаеорсухіјѕһԁԛԝ",
    "ABEZHIKMNOPTYXCJaovpuxABESIJKMHOPCTYXYQWaeopcyxijshdqw",
)
_DIGITS = str.maketrans("OoIl", "0011")
_SEPARATORS = re.compile(r"[\s_.‐‑‒–—−-]+")
_ZEROS = re.compile(r"(?<![0-9])0+(?=[0-9])")


def fold_spelling(code: str) -> str:
    """`code` without what people confuse: capitals, look-alike letters, O and 0, I, l and 1, separators, leading zeros.

    >>> fold_spelling("P01") == fold_spelling("p01") == fold_spelling("Р1") == fold_spelling("PO1")
    True
    >>> fold_spelling("1-11") == fold_spelling("11-1")
    False
    """
    plain = unicodedata.normalize("NFKC", code).translate(_ALIKE).translate(_DIGITS).casefold()
    return _ZEROS.sub("", _SEPARATORS.sub("-", plain).strip("-"))


def find_other_spelling(code: str, taken: Iterable[str]) -> str | None:
    """The one among the `taken` codes that is `code` in another spelling, in capitals, look-alikes, zeros or marks."""
    folded = (fold_spelling(code), code.casefold())
    return next(
        (one for one in taken if one != code and (fold_spelling(one) == folded[0] or one.casefold() == folded[1])), None
    )


def suggest_code(typed: str) -> str:
    """What `typed` says without spaces and in plain digits and letters; `typed` itself if it is that already."""
    return "".join(unicodedata.normalize("NFKC", typed).split())
