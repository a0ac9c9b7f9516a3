"""Both papers again: every number that they state beside the one computed here, and figures drawn from the chain."""

from haptorb.apps.reproduce.item import Item
from haptorb.apps.reproduce.registry import PAPERS, Reproduction, reproduced, reproductions
from haptorb.apps.reproduce.report import Made, report_page, summary

__all__ = ["PAPERS", "Item", "Made", "Reproduction", "report_page", "reproduced", "reproductions", "summary"]
