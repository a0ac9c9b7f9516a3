"""Opening a browser at an address with a token, without telling the token to the other accounts of this computer."""

from __future__ import annotations

import contextlib
import html
import os
import tempfile
import webbrowser
from pathlib import Path
from time import sleep

__all__ = ["open_browser_at"]

_LOADED = 30.0  #: a browser that starts has read the file by then [s]


def open_browser_at(url: str) -> None:
    """Open the browser at `url`; blocks for half a minute, for a thread that may be left.

    A program's arguments can be read by everybody (`ps`), so the browser is given a file that leads to the address and
    that only this account may read. A sandboxed browser that cannot read it shows an error; then use the printed
    address.
    """
    with contextlib.suppress(OSError, AttributeError):
        os.setpriority(os.PRIO_PROCESS, 0, 0)  # the browser is an ordinary program
    with tempfile.TemporaryDirectory(prefix="haptorb-") as folder:
        path = Path(folder, "open.html")
        path.write_text(
            '<!doctype html><meta charset="utf-8"><title>haptorb</title>'
            f'<meta http-equiv="refresh" content="0; url={html.escape(url)}">'
            f'<a href="{html.escape(url)}">Open the console</a>',
            encoding="utf-8",
        )
        webbrowser.open(path.as_uri())
        sleep(_LOADED)
