"""Formatting of numbers."""

from __future__ import annotations

import math

import pytest

from haptorb.display import format_number, format_quantity, format_vector


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (0.0529, "N/A", "52.9 mN/A"), (1.0, "N", "1 N"), (0.999999, "N", "1 N"), (0.0, "m", "0 m"),
        (20.0, "A", "20 A"), (8000.0, "A/s", "8 kA/s"), (3.2e-6, "s", "3.2 µs"), (298.15, "K", "298 K"),
        (2.407, "A·m²", "2.41 A·m²"), (0.02, "m²", "0.02 m²"), (4e-3, "kg", "4 g"), (math.inf, "N", "inf N"),
        (math.nan, "N", "unknown N"), (-0.05, "N·m", "-50 mN·m"), (1e-30, "T", "1e-18 pT"), (5.0, "", "5"),
        (12.5, "rad/s", "12.5 rad/s"), (1000.0, "Hz", "1 kHz"),
    ],
)  # fmt: skip
def test_quantities(value: float, unit: str, text: str) -> None:
    assert format_quantity(value, unit) == text


def test_vectors_share_a_prefix_and_rounding_reads_as_zero() -> None:
    assert format_vector((1e-18, -0.0, 0.05), "m") == "(0, 0, 50) mm"
    assert format_vector((0.0, 0.0, 0.0), "N") == "(0, 0, 0) N"
    assert format_vector((math.nan, 0.001), "N") == "(unknown, 1) mN"


def test_numbers() -> None:
    assert [format_number(x) for x in (123456.0, 0.1 + 0.2, 1e7)] == ["123456", "0.3", "1e+07"]
