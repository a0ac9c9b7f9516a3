"""Tables and curves for notebooks: well-formed, with escaped text."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import pytest

from haptorb.display import curves_svg, facts_html, pre_html, table_html


def test_texts_are_never_html() -> None:
    evil = "<script>alert('x')</script>&"
    for html in (facts_html(evil, [(evil, evil)]), table_html([evil, evil], [[evil, evil]]), pre_html(evil)):
        assert "<script" not in html
        ElementTree.fromstring(html)


def test_a_peak_of_one_sample_is_drawn() -> None:
    t = np.linspace(0.0, 10.0, 100_001)
    force = np.zeros_like(t)
    force[31_415] = 2.0
    svg = curves_svg(t, [("force", force), ("asked", 0 * force)], "s", "force [N]")
    tree = ElementTree.fromstring(svg)
    lines = [one for one in tree if one.tag.endswith("polyline")]
    heights = [float(point.split(",")[1]) for point in lines[0].attrib["points"].split()]
    assert len(lines) == 2
    assert min(heights) == 20.0
    assert len(svg) < 30_000
    assert "force [N]" in svg


@pytest.mark.parametrize(
    ("t", "y"), [([], []), ([0.0], [1.0]), ([0.0, 1.0], [np.nan, np.nan]), ([1.0, 1.0], [0.0, 1.0])]
)
def test_nothing_to_join_is_no_picture(t: list[float], y: list[float]) -> None:
    assert curves_svg(np.array(t), [("force", np.array(y))], "s", "N") == ""


def test_what_is_not_finite_is_left_out() -> None:
    t, y = np.arange(4.0), np.array([1.0, np.nan, np.inf, 2.0])
    svg = curves_svg(t, [("force", y)], "s", "N")
    assert "nan" not in svg
    assert "inf" not in svg
    ElementTree.fromstring(svg)
