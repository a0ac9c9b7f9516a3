"""From what was measured to a verdict, and to advice where the verdict is no."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, final

from haptorb.apps.check.machine import Machine, StolenTime
from haptorb.apps.terminal.notebook_report import NotebookReport

__all__ = ["LATENESS", "SUCCESS", "Fitness", "Verdict"]

SUCCESS = 0.999  #: share of ticks that must begin and end within their period
LATENESS = 150.0  #: 99 of 100 ticks must begin less than this after their deadline [µs]

_NAN = float("nan")


@dataclass(frozen=True)
class Verdict:
    """One threshold: the measured value, the required one, and whether it is met."""

    what: str
    measured: str
    wanted: str
    fit: bool


@final
@dataclass(frozen=True)
class Fitness(NotebookReport):
    """A run's report, the machine it ran on, and what the machine did meanwhile."""

    report: Mapping[str, Any]
    machine: Machine
    took: StolenTime
    duration: float  #: [s]
    dragging: bool

    printer: ClassVar[str] = "haptorb.apps.check.show:print_fitness"

    def _summarize(self) -> str:
        verdicts = ", ".join(f"{verdict.what} {verdict.measured}" for verdict in self.verdicts)
        return f"<Fitness: this computer is {'fit' if self.fit else 'not fit'}: {verdicts}>"

    @cached_property
    def verdicts(self) -> tuple[Verdict, ...]:
        """Every threshold in turn."""
        success, late = _number(self.report["success_rate"]), _number(self.report["lateness_us"]["p99"])
        trips = [trip["code"] for trip in self.report["trips"]]
        return (
            Verdict("ticks on time", f"{100 * success:.3f} %", f"at least {100 * SUCCESS:g} %", success >= SUCCESS),
            Verdict("lateness, 99 %", f"{late:.0f} µs", f"at most {LATENESS:g} µs", late <= LATENESS),
            Verdict("trips", ", ".join(trips) or "none", "none", not trips),
        )

    @property
    def fit(self) -> bool:
        """Whether every verdict is yes."""
        return all(verdict.fit for verdict in self.verdicts)

    @cached_property
    def advice(self) -> tuple[str, ...]:
        """What to do, most promising first; empty for a computer that is fit."""
        if self.fit:
            return ()
        scheduler = self.report["scheduler"]
        period = 1e6 / self.report["rate_hz"]
        busy = _number(self.report["compute_us"]["p99"])
        late = _number(self.report["lateness_us"]["p99"])
        found = []
        if scheduler.get("policy") != "SCHED_FIFO":
            found.append(
                "Allow a real-time scheduler: put '@USER - rtprio 50' and '@USER - memlock unlimited' (with your group "
                "for USER) into /etc/security/limits.d/haptorb.conf and log in again."
            )
        if busy > 0.6 * period:
            slower = max(50.0, 0.5e6 / busy)
            found.append(
                f"A tick takes {busy:.0f} of {period:.0f} µs: use --rate {slower:.0f} or less on this computer."
            )
        if self.took.stolen > 0.01 or (self.machine.virtual and self.report["missed"] > 2 * self.took.preempted):
            found.append(
                "This is a virtual machine, and its host interrupts ticks: assign dedicated processors to it, or "
                "use a physical computer."
            )
        if self.took.others > 0.5 * self.machine.cores and scheduler.get("policy") != "SCHED_FIFO":
            found.append(f"Other programs kept {self.took.others:.1f} of {self.machine.cores} cores busy: close some.")
        if self.machine.cores < 2:
            found.append("One core is not enough for a loop and a console: use two or more.")
        if self.machine.governor not in ("", "performance"):
            found.append(f"The processor's clock follows '{self.machine.governor}': set it to 'performance'.")
        if not self.machine.preemptible and late > LATENESS:
            found.append("This kernel cannot be interrupted everywhere: use one with PREEMPT or PREEMPT_RT.")
        if not found:
            found.append("No clear cause found: look for other real-time programs, and measure again for longer.")
        return tuple(found)

    def numbers(self) -> dict[str, Any]:
        """Everything as plain JSON types."""
        keys = ("device", "world", "driver", "rate_hz", "ticks", "missed", "success_rate", "lateness_us", "compute_us")
        return {
            "fit": self.fit,
            **{key: self.report[key] for key in (*keys, "stage_us", "ahead_us", "trips", "scheduler")},
            "duration_s": self.duration,
            "dragging": self.dragging,
            "verdicts": [vars(verdict) for verdict in self.verdicts],
            "advice": list(self.advice),
            "machine": vars(self.machine),
            "meanwhile": vars(self.took),
        }


def _number(value: float | None) -> float:
    return _NAN if value is None else value
