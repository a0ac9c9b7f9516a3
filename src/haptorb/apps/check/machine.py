"""What is known about this computer, and what it did while the loop ran."""

from __future__ import annotations

import os
import platform
from dataclasses import dataclass
from pathlib import Path
from typing import final

__all__ = ["Machine", "StolenTime", "StolenTimeCounter", "this_machine"]

#: fields of /proc/PID/stat behind the program's name: user and system time, scheduling policy
_USER, _POLICY = 11, 38


@dataclass(frozen=True)
class Machine:
    """Facts that matter to a real-time loop."""

    processor: str
    cores: int  #: that this process may use
    kernel: str
    preemptible: bool
    virtual: bool
    governor: str  #: of the processor's clock; empty where the kernel does not tell
    python: str


@dataclass(frozen=True)
class StolenTime:
    """What others took from the loop while it was measured."""

    preempted: int  #: times that the kernel gave the servo's processor to another process
    stolen: float  #: share of all processor time that a virtual machine's host kept for itself
    others: float  #: cores that were busy, the servo's own work included, but not what only keeps a core awake


def this_machine() -> Machine:
    """The computer that this runs on."""
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
    """Looks at the kernel's counters when it is made, and again in `took`."""

    def __init__(self, pid: int) -> None:
        self._pid = pid
        self._times = _times()
        self._preempted = _count_preemptions(pid)
        self._awake = _count_idle_ticks(pid)

    def measure(self) -> StolenTime:
        """What was taken since the beginning."""
        passed = [now - then for now, then in zip(_times(), self._times, strict=True)]
        total = max(sum(passed), 1)
        idle = passed[3] + passed[4] + max(_count_idle_ticks(self._pid) - self._awake, 0)
        return StolenTime(
            max(_count_preemptions(self._pid) - self._preempted, 0),
            passed[7] / total,
            max((os.cpu_count() or 1) * (total - idle - passed[7]) / total, 0.0),
        )


def _times() -> list[int]:
    """user, nice, system, idle, iowait, irq, softirq, steal of all processors together, in the kernel's ticks."""
    fields = _text("/proc/stat").partition("\n")[0].split()[1:9]
    return [int(field) for field in fields] or [0] * 8


def _count_preemptions(pid: int) -> int:
    for line in _text(f"/proc/{pid}/status").splitlines():
        if line.startswith("nonvoluntary_ctxt_switches:"):
            return int(line.split()[1])
    return 0


def _count_idle_ticks(pid: int) -> int:
    """Processor time of the children of `pid` that run only on an idle core, in the kernel's ticks."""
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
