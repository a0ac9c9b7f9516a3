"""`haptorb design show`: choose a design, see its device in the console, feel it."""

from __future__ import annotations

from haptorb.apps.design.show.chooser import PORT, Chooser

__all__ = ["PORT", "Chooser"]
