"""Greek letters, signs and superscripts in ASCII, for outputs whose encoding cannot carry them."""

from __future__ import annotations

import codecs
import sys
import unicodedata

from haptorb.files.foreign_text import visible

__all__ = ["fit_encoding", "use_ascii_fallback"]

_HANDLER = "haptorb.ascii"

#: sign → ASCII, where neither its name nor its decomposition gives it
_SIGNS = {
    "°": "deg", "℃": "degC", "Ω": "Ohm", "µ": "u", "μ": "u", "·": ".", "⋅": ".", "×": "x", "−": "-", "–": "-",
    "—": "-", "±": "+/-", "∓": "-/+", "≤": "<=", "≥": ">=", "≪": "<<", "≫": ">>", "≈": "~", "≠": "!=", "√": "sqrt",
    "∞": "inf", "∂": "d", "∇": "grad", "∫": "integral", "∮": "integral", "∈": "in", "‖": "||", "…": "...",
    "½": "1/2", "‰": " per mille", "§": "section ", "′": "'", "‘": "'", "’": "'", "“": '"', "”": '"', "„": '"',
    "•": "*", "◆": "o", "→": "->", "←": "<-", "↦": "->", "↑": "up", "↓": "down", "↗": "NE", "↖": "NW", "↙": "SW",
    "↘": "SE", "‾": "", "ℓ": "l", "€": "EUR", "█": "#", "━": "=", "─": "-", "│": "|", "├": "+", "└": "+", "┐": "+",
    "╭": "+", "╮": "+", "╯": "+", "╰": "+", "▶": ">",
}  # fmt: skip
_SCRIPTS = {"<super>": "^", "<sub>": "_"}


def fit_encoding(text: str, encoding: str) -> str:
    r"""`text` with ASCII in place of those characters that `encoding` does not have, and what would act on a terminal
    made visible: all that is printed passes here, as it may come from somebody's file.

    >>> fit_encoding("2 µΩ", "latin-1")
    '2 µOhm'
    >>> fit_encoding("θ = 30°, 2.5 µm², R ≤ 0.6 Ω → l̄ (Zárate)", "ascii")
    'theta = 30deg, 2.5 um^2, R <= 0.6 Ohm -> l (Zarate)'
    >>> print(fit_encoding("a recording called \x1b[2J", "utf-8"))
    a recording called \x1b[2J
    """
    text = visible(text)
    try:
        text.encode(encoding)
    except UnicodeEncodeError:
        return "".join(letter if _can_encode(encoding, letter) else _spell(letter) for letter in text)
    return text


def use_ascii_fallback() -> None:
    """Let standard output and error spell what their encoding cannot carry, instead of failing."""
    codecs.register_error(_HANDLER, _replace)
    for stream in (sys.stdout, sys.stderr):
        reconfigure = getattr(stream, "reconfigure", None)
        if reconfigure is not None and not (stream.encoding or "").lower().startswith("utf"):
            reconfigure(errors=_HANDLER)


def _replace(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return "".join(map(_spell, error.object[error.start : error.end])), error.end


def _can_encode(encoding: str, letter: str) -> bool:
    try:
        letter.encode(encoding)
    except UnicodeEncodeError:
        return False
    return True


def _spell(letter: str) -> str:
    if letter.isascii():
        return letter
    if letter in _SIGNS:
        return _SIGNS[letter]
    if unicodedata.combining(letter):
        return ""
    name = unicodedata.name(letter, "")
    if name.startswith("GREEK"):
        word = name.split()[-1 if "LETTER" in name else 1].lower().replace("lamda", "lambda")
        return word.capitalize() if "CAPITAL" in name else word
    kind, *_ = unicodedata.decomposition(letter).split()[:1] or [""]
    plain = "".join(_SIGNS.get(part, part) for part in unicodedata.normalize("NFKD", letter))
    return _SCRIPTS.get(kind, "") + plain.encode("ascii", "ignore").decode() or "?"
