"""Where programs of this account keep what lasts longer than a run, and is not computed again."""

from __future__ import annotations

import os
from pathlib import Path

__all__ = ["state_folder"]


def state_folder() -> Path:
    """Folder for the state of programs: $XDG_STATE_HOME/haptorb, else ~/.local/state/haptorb."""
    home = os.environ.get("XDG_STATE_HOME") or os.path.join(os.path.expanduser("~"), ".local", "state")
    return Path(home) / "haptorb"
