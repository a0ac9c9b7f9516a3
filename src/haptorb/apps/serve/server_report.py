"""What the servers of a run counted, for the run's report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

__all__ = ["describe_servers"]

#: key of a server's report → what people read
_COUNTS = {
    "dropped": "rows dropped because the server was too slow",
    "not_sent": "messages dropped for slow readers",
    "unread": "messages lost in a flood",
    "refused": "messages or connections refused",
    "stale": "commands refused because they had waited",
}


def describe_servers(servers: Sequence[Mapping[str, Any]]) -> list[str]:
    """One line for each server that dropped or refused something; of the others there is nothing to say.

    >>> describe_servers([{"server": "osc", "refused": 3, "dropped": 0}, {"server": "lsl", "dropped": 0}])
    ['osc: 3 messages or connections refused']
    """
    lines = []
    for one in servers:
        counted = [f"{one[key]} {text}" for key, text in _COUNTS.items() if one.get(key)]
        if counted:
            lines.append(f"{one['server']}: {'; '.join(counted)}")
    return lines
