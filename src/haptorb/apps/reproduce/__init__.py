"""Both papers again: every reproduced number beside the printed one, and the figures drawn from the chain itself."""

from haptorb.apps.reproduce.item import Item
from haptorb.apps.reproduce.registry import PAPERS, Reproduction, reproduced, reproductions

__all__ = ["PAPERS", "Item", "Reproduction", "reproduced", "reproductions"]
