"""Every symbol of the sources has an ASCII spelling."""

import io
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from haptorb.terminal import echo, fit_encoding, use_ascii_fallback


def test_no_sign_of_the_sources_is_lost(root):
    signs = set()
    for suffix in ("*.py", "*.toml"):
        for path in (path for place in ("src", "papers") for path in (root / place).rglob(suffix)):
            signs |= set(path.read_text(encoding="utf-8"))
    lost = {sign for sign in signs if "?" in fit_encoding(sign, "ascii") and sign != "?"}
    assert lost == set()


@given(st.text())
def test_any_text_is_spelled(text):
    assert fit_encoding(text, "ascii").isascii()
    assert fit_encoding(text, "utf-8") == text or not text.isprintable()


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "cp1252"])
def test_a_stream_of_another_encoding_does_not_fail(monkeypatch, encoding):
    raw = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(raw, encoding=encoding))
    use_ascii_fallback()
    echo("θ = 30°, 0.6 Ω → 2 µm²")
    print("−1 ≤ π", flush=True)
    text = raw.getvalue().decode(encoding)
    assert "theta = 30" in text
    assert "Ohm -> 2 " in text
    assert "-1 <= pi" in text
