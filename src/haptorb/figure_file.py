"""Figures that commands write: check of the path, atomic writing, text of strangers, and Matplotlib without their
settings."""

from __future__ import annotations

import os
import re
import sys
import tempfile
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from haptorb.cache_folder import private_folder
from haptorb.errors import InputError, quote
from haptorb.files import replace_file, visible

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["FORMATS", "check_figure_file", "ignore_local_settings", "show_text_as_is", "write_figure"]

#: supported formats, by file name extension
FORMATS = (".png", ".svg", ".pdf")
#: formulas that haptorb writes itself: components of a vector, and Matplotlib's numbers on an axis
_FORMULA = re.compile(r"\$[FT]_[xyz]\$|\$\\mathdefault\{[-−0-9.^{}×]*\}\$")


def ignore_local_settings() -> str:
    """Keep Matplotlib from reading a `matplotlibrc` of the current folder; return a line that says so, "" without one.

    Such a file may start LaTeX with a text of its own, and one that is a pipe stops the program. Matplotlib looks for
    it when it is imported, before the account's settings: here it is imported from an empty folder. To be called while
    the program has one thread, because all threads share the current folder.
    """
    name = "matplotlibrc"
    if not os.path.lexists(name) or "matplotlib" in sys.modules:
        return ""
    here = os.getcwd()
    try:
        os.chdir(private_folder("empty"))  # safety: no-local-matplotlibrc
        import_module("matplotlib")
    finally:
        os.chdir(here)
    return f"{name} in the current folder is not read; put settings into the one that Matplotlib keeps for you"


def check_figure_file(path: Path, option: str) -> Path:
    """Return `path` if a figure can be written there; otherwise InputError that names the `option`.

    >>> check_figure_file(Path("card.pdf"), "--plot").name
    'card.pdf'
    """
    if path.suffix.lower() not in FORMATS:
        raise InputError(f"{option} must be a .png, .svg or .pdf file; got {quote(str(path), 300)}")
    if path.is_dir():
        raise InputError(f"{option}: '{path}' is a folder; give the name of a file in it")
    if not path.parent.is_dir():
        raise InputError(f"{option}: the folder '{path.parent}' does not exist")
    try:
        tempfile.TemporaryFile(dir=path.parent).close()
    except OSError as cause:
        raise InputError(f"{option}: cannot write '{path}' ({cause.strerror}); choose another folder") from cause
    return path


def show_text_as_is(figure: Figure) -> Figure:
    """Have the texts of `figure` shown letter by letter, except haptorb's own formulas; return it.

    Names and titles come from files: `$` in one would begin a formula, and a wrong formula ends the drawing. Control
    characters are made visible. To be called before a figure is written, when all of it is drawn.
    """
    from matplotlib.text import Text

    for text in figure.findobj(Text):
        if not isinstance(text, Text) or not (content := text.get_text()):
            continue
        if "$" in content and not _FORMULA.fullmatch(content):
            text.set_parse_math(False)  # safety: no-formula
        if (shown := visible(content)) != content:
            text.set_text(shown)
    return figure


def write_figure(figure: Figure, path: Path, option: str) -> None:
    """Write `figure` in the format of the extension of `path`; InputError if the folder is not writable."""
    try:
        with replace_file(path) as part:
            show_text_as_is(figure).savefig(part, format=path.suffix.lower()[1:], dpi=150)
    except OSError as cause:
        raise InputError(f"{option}: cannot write '{path}': {cause.strerror or cause}") from cause
