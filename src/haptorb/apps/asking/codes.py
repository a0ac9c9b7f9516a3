"""When two codes of participants are one code in two spellings, and when a text is no code but was meant as one."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable

__all__ = ["find_other_spelling", "fold_spelling", "suggest_code"]

#: letters that look like Latin ones: Greek and Cyrillic, capitals and small
_ALIKE = str.maketrans(
    "\u0391\u0392\u0395\u0396\u0397\u0399\u039a\u039c\u039d\u039f\u03a1\u03a4\u03a5\u03a7"
    "\u03f9\u0408\u03b1\u03bf\u03bd\u03c1\u03c5\u0445\u0410\u0412\u0415\u0405\u0406\u0408"
    "\u041a\u041c\u041d\u041e\u0420\u0421\u0422\u0423\u0425\u04ae\u051a\u051c\u0430\u0435"
    "\u043e\u0440\u0441\u0443\u0445\u0456\u0458\u0455\u04bb\u0501\u051b\u051d",
    "ABEZHIKMNOPTYXCJaovpuxABESIJKMHOPCTYXYQWaeopcyxijshdqw",
)
_DIGITS = str.maketrans("OoIl", "0011")
_SEPARATORS = re.compile(r"[\s_.\u2010\u2011\u2012–—−-]+")
_ZEROS = re.compile(r"(?<![0-9])0+(?=[0-9])")


def fold_spelling(code: str) -> str:
    """`code` without what people confuse: capitals, look-alike letters, O and 0, I, l and 1, separators, leading zeros.

    >>> fold_spelling("P01") == fold_spelling("p01") == fold_spelling("\u04201") == fold_spelling("PO1")
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
