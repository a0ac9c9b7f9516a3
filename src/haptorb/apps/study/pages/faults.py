"""What goes wrong while a session is served: said in words, or left behind on the way out."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from haptorb.errors import InputError

__all__ = ["check_text", "explain_fault", "try_quietly"]


def check_text(command: Mapping[str, Any], name: str) -> str:
    """The text `name` of a page's `command`, empty if there is none; InputError if it is no text."""
    value = command.get(name, "")
    if not isinstance(value, str):
        raise InputError(f"{name} must be a text; got {type(value).__name__}")
    return value


def explain_fault(fault: BaseException) -> str:
    """What it was, and where."""
    frames = traceback.extract_tb(fault.__traceback__)
    where = f" ({Path(frames[-1].filename).name}, line {frames[-1].lineno})" if frames else ""
    return f"{type(fault).__name__}: {fault}{where}"


def try_quietly(do: Callable[[], object]) -> None:
    """On the way out one failure, foreseen or not, must not keep the next step from being taken."""
    try:
        do()
    except Exception:
        return
