"""Page of `haptorb reproduce`: text with all parts folded, and number formats."""

import re
from dataclasses import replace

import pytest

from haptorb_papers.reproduce import Item, Reproduction, ReproductionResult, report_page
from haptorb_papers.reproduce.statement_table import describe_tolerance, format_number

FORCE = Item("x", "bai2012", "Fig. 8", "a force", 1.04, 1.04, "N", 0.05)


def page_of(*items):
    return report_page([ReproductionResult(Reproduction("bai2012", "table 9", "nine"), items, None)])


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"published": 7.8}, "±0.05 N, the print’s last digit"),
        ({"published": 7.8, "implied": True}, "±0.05 N (0.64 %)"),  # nothing is printed: no digit is the last
        ({"published": 7.84}, "±0.05 N (0.64 %)"),
        ({"published": 25, "tolerance": 0.5}, "±0.5 N, the print’s last digit"),
        ({"published": 1.0, "corrected": 7.8}, "±0.05 N (0.64 %)"),  # nor is a correction the print
        ({"published": 50.0, "unit": "%"}, "±0.05 %"),
        ({"tolerance": 1e-9}, "9 digits"),
        ({"tolerance": 1e-9, "basis": "held"}, "the same number"),
        ({"tolerance": 0}, "exactly"),
        ({"published": 0.0, "tolerance": 2e-9}, "at most 2 × 10⁻⁹ N"),
        ({"published": -300, "tolerance": 3.0}, "±3 N (1 %)"),
        ({"published": None}, ""),
        ({"computed": None}, ""),
        ({"tolerance": None}, ""),
    ],
)
def test_a_tolerance_in_a_readers_words(changes, said):
    assert describe_tolerance(replace(FORCE, **changes)) == said


def test_no_number_is_written_as_programs_do():
    for value in (1e-9, -2.5e-7, 1.23456e8, 6.02e23, float("inf"), float("nan"), 0.1, -0.0):
        assert not re.search(r"\de|nan|inf\b|-", format_number(value)), value
    assert format_number(1.23456e8) == "1.2346 × 10⁸"


def test_what_differs_stands_above_what_folds_and_leads_to_its_row():
    page = page_of(FORCE, replace(FORCE, id="y", what="another force", computed=2.0))
    head = page[: page.index("<details")]
    assert "another force" in head
    assert "href='#bai2012-y'" in head
    assert "href='#bai2012-x'" not in head
    assert "id='bai2012-y'" in page
    assert "What differs" not in page_of(FORCE)


def test_every_part_folds_says_what_is_in_it_and_is_in_the_contents():
    page = page_of(FORCE, replace(FORCE, id="y", basis="held"), replace(FORCE, id="z", basis="held"))
    (part,) = re.findall(r"<details id='([^']+)'>(?!.*<details)", page)
    assert f"href='#{part}'" in page
    summary = page[page.index("<summary>") : page.index("</summary>")]
    assert "1 reproduced" in summary
    assert "2 transcribed" in summary
    assert "differs" not in summary
