"""Reproduction of both papers: every stated number beside the computed one, and figures drawn from the simulation."""

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
