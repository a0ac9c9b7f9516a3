"""Check of the computer: measure the loop, print verdicts and advice."""

from __future__ import annotations

import math
import os
import platform
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from time import monotonic, sleep
from typing import TYPE_CHECKING, Any, final

import numpy as np

from haptorb.arrays import Array
from haptorb.display import format_beside
from haptorb.errors import InputError
from haptorb.notebook import NotebookReport
from haptorb.runtime.servo import Servo
from haptorb.terminal import Column, TextTable, make_console, make_progress, print_table, print_text

if TYPE_CHECKING:
    from rich.console import Console

__all__ = [
    "MAX_LATENESS_US",
    "MIN_ON_TIME_FRACTION",
    "Fitness",
    "Machine",
    "StolenTime",
    "StolenTimeCounter",
    "Verdict",
    "drag_position",
    "measure_fitness",
    "print_fitness",
    "this_machine",
]


# --------------------------------------------------------------------------------------------------
# Facts about this computer, and the kernel's counters over the measurement.


#: fields of /proc/PID/stat behind the program's name: user and system time, scheduling policy
_USER, _POLICY = 11, 38


@dataclass(frozen=True)
class Machine:
    """Facts about the computer that affect a real-time loop."""

    processor: str
    cores: int  #: cores that this process may use
    kernel: str
    preemptible: bool
    virtual: bool
    governor: str  #: governor of the processor's clock; empty if unknown
    python: str


@dataclass(frozen=True)
class StolenTime:
    """Processor time taken by others during the measurement."""

    preempted: int  #: times that the kernel gave the servo's processor to another process
    stolen: float  #: share of all processor time that a virtual machine's host kept for itself
    others: float  #: cores that were busy, the servo's own work included, the process that keeps a core awake excluded


def this_machine() -> Machine:
    """Return the facts about this computer."""
    processor = ""
    flags = ""
    for line in _text("/proc/cpuinfo").splitlines():
        key, _, value = line.partition(":")
        if key.strip() == "model name":
            processor = processor or value.strip()
        elif key.strip() == "flags":
            flags = flags or value
    return Machine(
        processor or platform.machine(),
        len(os.sched_getaffinity(0)),
        f"{platform.release()} {platform.version()}",
        "PREEMPT" in platform.version(),
        "hypervisor" in flags.split(),
        _text("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor").strip(),
        platform.python_version(),
    )


@final
class StolenTimeCounter:
    """Reads the kernel's counters at construction and again in `measure`."""

    def __init__(self, pid: int) -> None:
        self._pid = pid
        self._times = _times()
        self._preempted = _count_preemptions(pid)
        self._awake = _count_idle_ticks(pid)

    def measure(self) -> StolenTime:
        """Return the processor time taken since construction."""
        passed = [now - then for now, then in zip(_times(), self._times, strict=True)]
        total = max(sum(passed), 1)
        idle = passed[3] + passed[4] + max(_count_idle_ticks(self._pid) - self._awake, 0)
        return StolenTime(
            max(_count_preemptions(self._pid) - self._preempted, 0),
            passed[7] / total,
            max((os.cpu_count() or 1) * (total - idle - passed[7]) / total, 0.0),
        )


def _times() -> list[int]:
    """Return user, nice, system, idle, iowait, irq, softirq, steal of all processors together [kernel ticks]."""
    fields = _text("/proc/stat").partition("\n")[0].split()[1:9]
    return [int(field) for field in fields] or [0] * 8


def _count_preemptions(pid: int) -> int:
    for line in _text(f"/proc/{pid}/status").splitlines():
        if line.startswith("nonvoluntary_ctxt_switches:"):
            return int(line.split()[1])
    return 0


def _count_idle_ticks(pid: int) -> int:
    """Return the processor time of children of `pid` with idle priority [kernel ticks]."""
    ticks = 0
    for child in _text(f"/proc/{pid}/task/{pid}/children").split():
        fields = _text(f"/proc/{child}/stat").rpartition(")")[2].split()
        if len(fields) > _POLICY and int(fields[_POLICY]) == os.SCHED_IDLE:
            ticks += int(fields[_USER]) + int(fields[_USER + 1])
    return ticks


def _text(path: str) -> str:
    try:
        return Path(path).read_text()
    except OSError:
        return ""


MIN_ON_TIME_FRACTION = 0.999  #: share of ticks that must begin and end within their period
MAX_LATENESS_US = 150.0  #: 99 of 100 ticks must begin less than this after their deadline [µs]

_NAN = float("nan")


@dataclass(frozen=True)
class Verdict:
    """One criterion: measured value, threshold, and whether it is met."""

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

    def show(self, console: Console) -> None:
        """Print the report on `console`."""
        print_fitness(self, console)

    def _summarize(self) -> str:
        verdicts = ", ".join(f"{verdict.what} {verdict.measured}" for verdict in self.verdicts)
        return f"<Fitness: this computer is {'fit' if self.fit else 'not fit'}: {verdicts}>"

    @cached_property
    def verdicts(self) -> tuple[Verdict, ...]:
        """Return the verdict on every criterion."""
        success, late = _number(self.report["success_rate"]), _number(self.report["lateness_us"]["p99"])
        trips = [trip["code"] for trip in self.report["trips"]]
        return (
            Verdict(
                "ticks on time",
                f"{format_beside(100 * success, 100 * MIN_ON_TIME_FRACTION, 3)} %",
                f"at least {100 * MIN_ON_TIME_FRACTION:g} %",
                success >= MIN_ON_TIME_FRACTION,
            ),
            Verdict(
                "lateness, 99 %",
                f"{format_beside(late, MAX_LATENESS_US, 0)} µs",
                f"at most {MAX_LATENESS_US:g} µs",
                late <= MAX_LATENESS_US,
            ),
            Verdict("trips", ", ".join(trips) or "none", "none", not trips),
        )

    @property
    def fit(self) -> bool:
        """Whether all criteria are met."""
        return all(verdict.fit for verdict in self.verdicts)

    @cached_property
    def advice(self) -> tuple[str, ...]:
        """Return recommendations, most effective first; empty if the computer is fit."""
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
        if not self.machine.preemptible and late > MAX_LATENESS_US:
            found.append("This kernel cannot be interrupted everywhere: use one with PREEMPT or PREEMPT_RT.")
        if not found:
            found.append("No clear cause found: look for other real-time programs, and measure again for longer.")
        return tuple(found)

    def numbers(self) -> dict[str, Any]:
        """Return everything as plain JSON types."""
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


# --------------------------------------------------------------------------------------------------
# Measurement of the loop on the simulated device, with a client that drags and reads as a console does.


_FRAME_S = 1 / 60  #: a console's frame period [s]


def measure_fitness(
    duration: float = 30.0, *, rate: float = 1000.0, device: str = "omni", dragging: bool = True, progress: bool = True
) -> Fitness:
    """Run the loop for `duration` [s] and judge it. With `dragging`, a client in this process drags and reads at 60 Hz.

    Shows a progress bar on the terminal by default. Raises InputError for a duration below 0.5 s.
    """
    if not (math.isfinite(duration) and duration >= 0.5):
        raise InputError(f"duration must be at least 0.5 s; got {duration!r} s")
    with (
        make_progress(show=progress) as bar,
        Servo(device, rate=rate, record=False) as servo,
    ):
        task = bar.add_task("measuring the loop", total=duration)
        watch, begin, cursor = StolenTimeCounter(servo.servo_pid), monotonic(), 0
        while (t := monotonic() - begin) < duration:
            servo.check()
            if dragging:
                servo.hand.point(drag_position(t))
                cursor, _ = servo.rows(cursor)
            if int(t / _FRAME_S) % 30 == 0:
                bar.update(task, completed=t)
            sleep(max(_FRAME_S - (monotonic() - begin - t), 0.0))
        took = watch.measure()
    return Fitness(servo.report(), this_machine(), took, duration, dragging)


def drag_position(t: float) -> Array:
    """Return the pointer position at time `t` (3,) [m]: a circle around the summit, pressing on the dome."""
    tilt, turn = math.radians(15 + 12 * math.sin(0.9 * t)), 1.7 * t
    return 0.048 * np.array([math.sin(tilt) * math.cos(turn), math.sin(tilt) * math.sin(turn), math.cos(tilt)])


# --------------------------------------------------------------------------------------------------
# Report for the terminal.


def print_fitness(fitness: Fitness, console: Console | None = None) -> None:
    """Print verdicts, times, the machine and what to do about it."""
    console = console or make_console()
    report, machine, took = fitness.report, fitness.machine, fitness.took
    client = "with a client dragging at 60 Hz" if fitness.dragging else "alone"
    print_text(
        console,
        f"{report['device']} (simulated), {report['rate_hz']:g} Hz, {fitness.duration:g} s {client}: "
        f"{report['ticks']} ticks, {report['missed']} deadlines missed\n",
    )
    verdicts = TextTable((Column("criterion", kind="key"), Column("measured", kind="text"),
                          Column("wanted", kind="text"), Column("verdict", kind="short")))  # fmt: skip
    for verdict in fitness.verdicts:
        verdicts.add_row(verdict.what, verdict.measured, verdict.wanted, "pass" if verdict.fit else "FAIL")
    print_table(console, verdicts)
    print_text(console)
    times = TextTable((Column("time", kind="key"), *(Column(share, "µs") for share in ("50 %", "99 %", "99.9 %"))))
    for name in ("lateness", "compute"):
        values = report[f"{name}_us"].values()
        times.add_row(name, *("–" if value is None else f"{value:.0f}" for value in values))
    ahead = report["ahead_us"]
    if ahead:
        times.add_row("simulated device, before", f"{ahead['p50']:.0f}", f"{ahead['p99']:.0f}", "")
    print_table(console, times)
    scheduler = report["scheduler"]
    print_text(
        console,
        f"\n{machine.processor}, {machine.cores} cores{', virtual' if machine.virtual else ''}; kernel "
        f"{machine.kernel}; scheduler {scheduler.get('policy', 'unknown')}"
        f"{', memory locked' if scheduler.get('memory_locked') else ', memory not locked'}"
        f"{', core kept awake' if scheduler.get('awake') else ''}; "
        f"{took.others:.1f} cores busy, {100 * took.stolen:.1f} % stolen by the host, preempted {took.preempted} times",
    )
    if fitness.fit:
        print_text(console, "This computer is fit for a real-time loop.", "bold green")
    else:
        print_text(console, "This computer is not yet fit for a real-time loop.", "bold red")
        for advice in fitness.advice:
            print_text(console, f"• {advice}", indent="  ")
