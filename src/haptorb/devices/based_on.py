"""Tables of a device file that is `based_on` another one: laid over those of its base, without the keys it drops."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any

from haptorb.errors import quote

__all__ = ["drop_keys", "has_key", "is_table", "lay_over", "lay_over_base"]

#: What a variant that states `windings.fill` has of its windings, instead of what its base states
_OF_FILL = (
    "electromagnet.moment_per_current", "coils.resistance", "coils.inductance", "coils.heat.winding_capacity",
)  # fmt: skip


def lay_over(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """`below` overridden by `above`: tables are merged, values and lists replaced.

    >>> lay_over({"dome": {"radius": "30 mm", "friction": 0.1}}, {"dome": {"radius": "31 mm"}})
    {'dome': {'radius': '31 mm', 'friction': 0.1}}
    """
    merged = dict(below)
    for key, value in above.items():
        both = isinstance(value, Mapping) and isinstance(below.get(key), Mapping) and "value" not in value
        merged[key] = lay_over(below[key], value) if both else value
    return merged


def lay_over_base(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """As `lay_over`, of the tables of a base device; what `above` states in another way is no longer the base's."""
    return lay_over(drop_keys(below, _find_replaced(below, above)), above)


def _find_replaced(below: Mapping[str, Any], above: Mapping[str, Any]) -> list[str]:
    """Keys of the base `below` in whose place `above` states an alternative: two ways to say the same do not add."""
    ours, theirs = above.get("windings"), below.get("windings")
    if not isinstance(ours, Mapping) or not isinstance(theirs, Mapping):
        return []
    wire = ("windings.wire", "windings.wire_overall")
    replaced = (*wire, *_OF_FILL) if "fill" in ours else ("windings.fill",) if "wire" in ours else ()
    return [key for key in replaced if has_key(below, key) and not has_key(above, key)]


def has_key(values: Any, key: str) -> bool:
    """Whether the tables `values` state `key`, dotted."""
    for part in key.split("."):
        if not isinstance(values, Mapping) or "value" in values or part not in values:
            return False
        values = values[part]
    return True


def drop_keys(values: Mapping[str, Any], drop: Any) -> dict[str, Any]:
    """A copy of `values` without the keys that `drop` lists, dotted. ValueError for one that is not there.

    >>> drop_keys({"hall": {"noise": 0.1, "step": 0.2}}, ["hall.noise"])
    {'hall': {'step': 0.2}}
    """
    if not isinstance(drop, list) or not all(isinstance(key, str) for key in drop):
        raise ValueError(
            f"drop must be a list of keys of the base device, such as ['windings.wire']; got {quote(drop)}"
        )
    kept = copy.deepcopy(dict(values))
    for key in drop:
        *path, last = key.split(".")
        table: Any = kept
        for part in path:
            table = table.get(part) if isinstance(table, dict) and "value" not in table else None
        if not isinstance(table, dict) or "value" in table or last not in table:
            raise ValueError(f"drop: the base device has no key {quote(key)}")
        del table[last]
    return kept


def is_table(values: Any, key: str) -> bool:
    """Whether `key`, dotted, is a table in `values`, and not a value with unit or source."""
    for part in key.split("."):
        values = values[part]
    return isinstance(values, Mapping) and "value" not in values
