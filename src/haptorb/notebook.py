"""Reports of commands as notebook output."""

from __future__ import annotations

from abc import ABC, abstractmethod
from io import StringIO
from typing import TYPE_CHECKING

from haptorb.display import Presentable, pre_html

if TYPE_CHECKING:
    from rich.console import Console

__all__ = ["NotebookReport"]

_LINE_WIDTH = 110  #: line width in a notebook [characters]


class NotebookReport(Presentable, ABC):
    """A report with a summary of one line; in a notebook it is shown as its command prints it."""

    @abstractmethod
    def show(self, console: Console) -> None:
        """Print the report on `console`."""

    def render_text(self, width: int = _LINE_WIDTH) -> str:
        """Return the output of `show`, in lines of at most `width` characters without colour."""
        from rich.console import Console

        file = StringIO()
        self.show(Console(file=file, width=width, markup=False, emoji=False, highlight=False, color_system=None))
        return "\n".join(line.rstrip() for line in file.getvalue().rstrip().splitlines())

    def _repr_html_(self) -> str:
        return pre_html(self.render_text())
