"""The report of a run: a dict of plain JSON types whose repr shows the main figures."""

from __future__ import annotations

from typing import Any, final

from haptorb.display.html import facts_html
from haptorb.display.quantity_text import format_quantity

__all__ = ["RunReport"]

_SHARES = {"p50": "50 %", "p99": "99 %", "p999": "99.9 %"}


@final
class RunReport(dict[str, Any]):
    """What `Servo.report` returns. `dict(report)` shows everything.

    >>> RunReport(device="omni", world="dome", ticks=5000, missed=0, trip_count=0, peak_force_n=0.25)
    <RunReport of omni, world dome: 5000 ticks, deadlines missed 0, trips 0, largest force 250 mN>
    """

    def __repr__(self) -> str:
        parts = [f"{self.get('ticks', 0)} ticks", f"deadlines missed {self.get('missed', 0)}"]
        parts += [f"trips {self.get('trip_count', 0)}", *(f"{name} {text}" for name, text in self._largest())]
        return f"<RunReport of {self.get('device')}, world {self.get('world')}: {', '.join(parts)}>"

    def _repr_html_(self) -> str:
        share = self.get("success_rate")
        trips = ", ".join(str(trip.get("code")) for trip in self.get("trips", ())) or "none"
        recorded = self.get("recorded") or {}
        facts = [
            ("device", f"{self.get('device')}, driver {self.get('driver')}, tracker {self.get('tracker')}"),
            ("world", str(self.get("world"))),
            ("rate", f"{self.get('rate_hz', float('nan')):g} Hz"),
            ("ticks", f"{self.get('ticks', 0)}, {self.get('missed', 0)} deadlines missed"),
            ("on time", "unknown" if share is None else f"{100 * share:.3f} %"),
            ("lateness", _list_percentiles(self.get("lateness_us"))),
            ("computing", _list_percentiles(self.get("compute_us"))),
            *self._largest(),
            ("trips", trips),
            ("coils", str(self.get("coil_state") or "unknown")),
            ("recorded", f"{recorded.get('rows', 0)} rows, {recorded.get('lost', 0)} lost"),
            ("warning", str(self.get("warning") or "")),
            ("error", str(self.get("error") or "")),
        ]
        return facts_html(f"Run of {self.get('device')}", [(name, text) for name, text in facts if text])

    def _largest(self) -> list[tuple[str, str]]:
        """Force and torque, where there was any."""
        found = (("largest force", "peak_force_n", "N"), ("largest torque", "peak_torque_nm", "N·m"))
        return [(name, format_quantity(self[key], unit)) for name, key, unit in found if self.get(key)]


def _list_percentiles(shares: Any) -> str:
    """Shares of the ticks and their times [µs], as `p50` … of the report; empty without any."""
    if not isinstance(shares, dict):
        return ""
    return ", ".join(f"{_SHARES.get(name, name)} up to {value:.0f} µs" for name, value in shares.items() if value)
