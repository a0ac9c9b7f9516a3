"""Both papers again: every number that they state beside the one computed here, and figures drawn from the chain."""

from haptorb_papers.reproduce.item import Item
from haptorb_papers.reproduce.page import report_page
from haptorb_papers.reproduce.registry import PAPERS, Reproduction, find_reproduction, reproductions
from haptorb_papers.reproduce.report import ReproductionResult, summary

__all__ = [
    "PAPERS",
    "Item",
    "Reproduction",
    "ReproductionResult",
    "find_reproduction",
    "report_page",
    "reproductions",
    "summary",
]
