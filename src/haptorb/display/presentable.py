"""What values have in common that a notebook shows: one or two lines of text, and a small table as HTML."""

from __future__ import annotations

from typing import Any

from haptorb.display.html import facts_html

__all__ = ["Presentable"]


class Presentable:
    """Shows itself by a summary of one or two lines, and by facts. Dataclasses keep this `repr` and write none.

    The names begin with an underscore because subclasses have fields that other people name.
    """

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if "__repr__" not in vars(cls):
            cls.__repr__ = cls.__repr__  # type: ignore[method-assign]  # `dataclass` writes its own where it finds none

    def _summarize(self) -> str:
        """What it is, in one or two lines."""
        return object.__repr__(self)

    def _list_facts(self) -> list[tuple[str, str]]:
        """Names and figures with units, for a table."""
        return []

    def __repr__(self) -> str:
        return self._summarize()

    def _repr_html_(self) -> str:
        return facts_html(self._summarize(), self._list_facts(), self._picture_html())

    def _picture_html(self) -> str:
        """HTML below the table; empty for none."""
        return ""
