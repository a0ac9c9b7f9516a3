"""Whether a scene does less than it should: read off the memory that its rows have."""

from __future__ import annotations

import json
from typing import Any

from haptorb.runtime.exchange.shared_memory import SharedMemory, Word

__all__ = ["describe_detail", "read_detail"]


def read_detail(shared: SharedMemory) -> dict[str, Any]:
    """Of the world that is rendered, if it is a scene: `detail` (0: full), `lighter_ticks` with less, and `behind_s`
    [s], by which its time has fallen behind; empty for every other world."""
    changes, row = shared.worlds_since(shared.words[Word.WORLD] - 1), shared.ring.latest()
    if not changes or row is None:
        return {}
    at, start = {}, shared.layout["memory"].start
    for field in json.loads(changes[-1][1]).get("memory", []):
        at[field["name"]] = start
        size = 1
        for length in field["shape"]:
            size *= length
        start += size
    if not {"detail", "lighter", "behind"} <= at.keys() or not (row[at["lighter"]] >= 0.0):
        return {}
    return {
        "detail": int(row[at["detail"]]),
        "lighter_ticks": int(row[at["lighter"]]),
        "behind_s": float(row[at["behind"]]),
    }


def describe_detail(found: dict[str, Any], *, now: bool = False) -> str:
    """One sentence for people about what `read_detail` has found; empty while a scene had full detail.

    now: only while it has less.
    """
    if not found or not found["lighter_ticks"] or (now and not found["detail"]):
        return ""
    text = f"the scene took too long for its tick and reduced its detail in {found['lighter_ticks']} ticks"
    if found["behind_s"] > 0.0:
        text += f"; its time is {found['behind_s']:.3g} s behind"
    return f"{text}. Use fewer bodies and contacts, a longer timestep, fewer solver iterations, or a lower --rate"
