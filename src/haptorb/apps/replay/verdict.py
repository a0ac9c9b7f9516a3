"""What a replay found, in words and in numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from haptorb.apps.terminal import Column, TextTable
from haptorb.display.quantity_text import format_number

if TYPE_CHECKING:
    from haptorb.runtime.replay.comparison import Difference, RunComparison
    from haptorb.runtime.replay.replay import Replay

__all__ = ["difference_table", "list_numbers", "list_replay_facts", "tell_verdict"]


def tell_verdict(replay: Replay) -> str:
    """Whether every number is the same, or where the first one differs."""
    found = replay.comparison
    ticks = f"{found.compared} ticks"
    if replay.replaced:
        return f"replayed with another {' and another '.join(replay.replaced)}: {_tell_share(found)}"
    if found.identical and not replay.approximate:
        return f"identical: every number of {ticks} is the same, bit for bit"
    if replay.missing:
        return f"near, because this older recording does not contain the samples: {_tell_share(found)}"
    if replay.approximate:
        return (
            f"near, because the recording does not contain the state of the loop at its beginning: {_tell_share(found)}"
        )
    return f"different: {_tell_share(found)}"


def _tell_share(found: RunComparison) -> str:
    if found.first is None:
        return f"all {found.compared} ticks are the same, bit for bit"
    return f"{found.differing} of {found.compared} ticks differ, first tick {found.first.tick} at {found.first.t:.4g} s"


def list_replay_facts(replay: Replay) -> list[tuple[str, str]]:
    """Names and texts: what ran, the first difference, and what stands in for what."""
    facts = [("verdict", tell_verdict(replay))]
    first = replay.comparison.first
    if first is not None:
        facts.append(("first difference", _describe(first)))
    if not replay.recorded.same_software:
        facts.append(("made by", replay.recorded.describe_software()))
    facts += [("ran code", code) for code in replay.recorded.code.values()]
    facts += [("remark", remark) for remark in replay.remarks]
    return facts


def _describe(first: Difference) -> str:
    unit = f" {first.unit}" if first.unit not in ("", "1") else ""
    return (
        f"{first.field}[{first.number}]: recorded {first.recorded!r}, replayed {first.replayed!r}{unit}; "
        f"{format_number(first.size)} apart"
    )


def difference_table(replay: Replay) -> TextTable:
    """The fields that differ: in how many ticks, by at most how much, and how large they are."""
    table = TextTable(
        (
            Column("field", kind="key"), Column("from tick", kind="short"), Column("ticks", kind="short"),
            Column("at most", kind="short"), Column("of up to", kind="short"), Column("unit", kind="short"),
        )
    )  # fmt: skip
    for one in replay.comparison.bounds:
        table.add_row(
            one.field, str(one.first), str(one.ticks), f"{one.largest:.3g}", f"{one.greatest:.3g}",
            one.unit.removeprefix("1"),
        )  # fmt: skip
    return table


def list_numbers(replay: Replay, seconds: float, took: float) -> dict[str, Any]:
    """The same as plain JSON types; `seconds` of the run that took `took` [s]."""
    found, first = replay.comparison, replay.comparison.first
    return {
        "identical": found.identical and not replay.approximate,
        "approximate": replay.approximate,
        "replaced": list(replay.replaced),
        "ticks": len(replay),
        "ticks_compared": found.compared,
        "ticks_different": found.differing,
        "numbers_compared": found.numbers,
        "first": None
        if first is None
        else {
            "tick": first.tick,
            "t_s": first.t,
            "field": first.field,
            "number": first.number,
            "unit": first.unit,
            "recorded": first.recorded,
            "replayed": first.replayed,
            "difference": first.size,
        },
        "fields": [
            {
                "name": one.field,
                "unit": one.unit,
                "first_tick": one.first,
                "ticks": one.ticks,
                "largest_difference": one.largest,
                "largest_recorded": one.greatest,
            }
            for one in found.bounds
        ],
        "missing_fields": list(replay.missing),
        "same_software": replay.recorded.same_software,
        "software": dict(replay.recorded.software),
        "ran_code": list(replay.recorded.code.values()),
        "remarks": list(replay.remarks),
        "duration_s": seconds,
        "took_s": took,
        "times_real_time": seconds / took if took > 0 else None,
    }
