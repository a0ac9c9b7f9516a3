"""Two hundred kinds of text that people, keyboards and clipboards enter into a field."""

from __future__ import annotations

import random

__all__ = ["TEXTS"]

_NUMBERS = [
    "3", "-3", "+3", "03", "3.0", "3.", ".3", "3,0", "2.5", "2,5", "1,000", "1.000", "1 000",
    "1e0", "1e9", "1E3", "1e-3",
    "0x3",
    "0b11", "0", "-0", "00", "7", "8", "12", "100", "1000000", "1000001", "999999999", "1234567890123456789",
    "0.1234567890123456789", "3;", "3)", "(3)", "#3", "3 ", " 3", "3\t", "\t3", "3\u00a0", "\u20093", "3\u200b",
    "\ufeff3",
    "３", "３.５", "٣", "۳", "३", "²", "③", "Ⅲ", "三", "½", "3½", "∞", "NaN", "nan", "Infinity", "-Infinity", "inf",
    "1_0",
    "1'000", "3-",
    "--3", "3+4", "1/2", "3%", "3 N", "3N", "three", "drei", "null", "None", "undefined", "true", "3.5.1",
    "1,2,3", "3e", "e3", "3..", "−3", "–3", "3°", "$3", "3€", "'3", '"3"', "=3", "=1+1", "@3", "3\\", "3/", "O", "l",
    "I3",
    "3O", "10^3", "1·5", "1٫5", "5\u0301",
]  # fmt: skip
_WORDS = [
    "", " ", "   ", "-", ".", ",", "P01", "p01", " P01", "P01 ", "P 01", "Р01", "P０1", "Anna", "Anna 7", "SIM01",
    "sim1",
    "vp-7", "vp_7", "Ä3", "A\u03083", "被験者12", "🙂", "🙂7", "a🙂b", "P01\u202e", "\u202eP01", "<b>3</b>",
    "<script>alert(1)</script>", "&amp;", "'; DROP TABLE trials; --", "../P01", "P01/..", "C:\\P01", "%33", "\\u0033",
    "{{3}}", "${3}", "x" * 17, "x1" * 8, "x1" * 9, "1" * 40, "1" * 400, "word " * 20, "two  spaces", "tab\there",
    "it's “quoted”", "ﬁ1", "ß1", "İ1", "ǆ1", "e\u0301\u03021", "\u200f1", "1\u200d", "a1.", "a1-", ".a1", "_a1", "1a9",
    "9a1", "a-1-b", "A1,B2", "a1\u00ad",
]  # fmt: skip


def _make() -> tuple[str, ...]:
    draw = random.Random(36)
    kinds = ["0123456789", "0123456789.,-+eE ", "abcPO0Il1-_. ", "äßжΩ被🙂٣３²\u00a0\u200b"]
    found = dict.fromkeys(_NUMBERS + _WORDS)
    while len(found) < 200:
        letters = "".join(draw.sample(kinds, draw.randint(1, len(kinds))))
        found["".join(draw.choices(letters, k=draw.randint(1, 12)))] = None
    return tuple(found)[:200]


TEXTS = _make()
