"""Limits of the torque scale of a feel session: stability check, and the device's torque limit.

The check covers the workspace and takes seconds per design, so it runs in a process of its own at low priority,
while the first design is being rendered. Every start of `haptorb` loads this module with `feel.cli`: what takes seconds
to import is imported where it is needed.
"""

from __future__ import annotations

import math
import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from json import JSONDecodeError, dumps, loads
from pathlib import Path
from typing import TYPE_CHECKING, final

from haptorb.errors import InputError
from haptorb.runtime.linux import lower_share, start_python

if TYPE_CHECKING:
    from haptorb_study.feel import Candidate, Candidates
    from haptorb_study.feel.torque_scale import ScaleLimits, TrueScale

__all__ = ["DesignChoice", "StabilityCheck", "find_limits"]


# --------------------------------------------------------------------------------------------------
# Designs of a session: those of a file, or the user's own worlds.


@dataclass(frozen=True)
class DesignChoice:
    """Either a snap-fit file, or `worlds` (FILE.py:NAME) with common `settings` (NAME=VALUE)."""

    file: str = ""
    worlds: tuple[str, ...] = ()
    settings: tuple[str, ...] = ()

    @classmethod
    def of(cls, file: Path | None, worlds: Sequence[str], settings: Sequence[str]) -> DesignChoice:
        """From the command's arguments. Raises InputError for neither, both, and worlds of the catalogue."""
        from haptorb.worlds.user_world import is_world_file

        if (file is None) == (not worlds):
            raise InputError(
                "give a snap-fit file (haptorb feel designs.toml) or your own worlds (--world FILE.py:NAME)"
            )
        if settings and not worlds:
            raise InputError("--set is for --world; in a snap-fit file, write the values into it")
        for world in worlds:
            if not is_world_file(world):
                raise InputError(
                    f"--world must be FILE.py:NAME here; got '{world}'. Describe snap-fits in a snap-fit file"
                )
        return cls(str(file or ""), tuple(worlds), tuple(settings))

    @property
    def folder(self) -> Path:
        """Default folder of ratings and traces: beside the file."""
        from haptorb.worlds.user_world import parse_world_file

        file = Path(self.file) if self.file else parse_world_file(self.worlds[0]).path
        return file.with_name(f"{file.stem}-session")

    def load(self) -> Candidates:
        """Load the designs. Raises InputError as `load_designs` and the world's file do."""
        from haptorb.cli.own_code import start_world_file
        from haptorb.cli.world_option import parse_settings
        from haptorb.control.linkage import Gains
        from haptorb.worlds.base import parameters
        from haptorb.worlds.user_world import parse_world_file
        from haptorb_study.feel import Candidates, load_designs
        from haptorb_study.feel.designs import own_candidate

        if self.file:
            return load_designs(self.file)
        designs = []
        for text in self.worlds:
            file = parse_world_file(text)
            world = start_world_file(file)
            values = parse_settings(list(self.settings), parameters(type(world)))
            designs.append(own_candidate(file, world.name, dict(values)))
        names = [design.name for design in designs]
        if len(set(names)) < len(names):
            raise InputError(f"--world: two worlds have the same name ({', '.join(names)}); rename one of the classes")
        return Candidates(", ".join(names), "timoshenko", Gains(), tuple(designs))


@final
class StabilityCheck:
    """Stability check of the designs `names` of `choice` on `device`, in a process of its own; `close` ends it."""

    def __init__(self, choice: DesignChoice, device: str, names: Sequence[str]) -> None:
        self._count = len(names)
        asked = dumps({"choice": asdict(choice), "device": device, "names": list(names)})
        self._process = start_python(
            "haptorb_study.feel.limits", asked,
            stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, stdin=subprocess.DEVNULL,
        )  # fmt: skip

    def wait(self) -> float | None:
        """Smallest gain margin of all designs; None if the check did not finish."""
        out, _ = self._process.communicate()
        try:
            margins = [float(loads(line)) for line in out.splitlines()]
        except (JSONDecodeError, TypeError, ValueError):
            return None
        return min(margins) if len(margins) == self._count else None

    def close(self) -> None:
        """End the check; a `wait` in another thread returns."""
        self._process.kill()


def find_limits(scale: TrueScale, designs: Sequence[Candidate], margin: float | None) -> ScaleLimits:
    """Limits for `designs`, whose smallest stability `margin` is known, or None.

    At the maximum scale a gain margin of `check.MIN_STABILITY_MARGIN` remains, and the peak force reaches the device's
    torque limit.
    """
    from haptorb.analysis.stability import MIN_STABILITY_MARGIN
    from haptorb_study.feel import course
    from haptorb_study.feel.torque_scale import ScaleLimits

    peaks = [max(run.going_in.max(), run.coming_out.max()) for run in map(course, designs)]
    full = scale.find_saturation(float(max(peaks)))
    if margin is None:
        return ScaleLimits(1.0, "the stability check did not finish", scale.hand_per_part)
    stable = margin / MIN_STABILITY_MARGIN
    if stable < full:
        reason = (
            f"in a light grip the handle vibrates from {margin:.3g}; "
            f"the maximum is that divided by {MIN_STABILITY_MARGIN:g}"
        )
    else:
        reason = (
            f"at that scale the device reaches its limit of {scale.limit:g} N·m at the greatest force "
            f"({max(peaks):.1f} N)"
        )
    found = min(stable, full)
    if found < 1.0:
        reason = f"force_scale of the snap-fit file is too large, the largest is {found:.2g} times that value: {reason}"
    return ScaleLimits(max(found, 1.0), reason, scale.hand_per_part)


def main(asked: str) -> None:
    """Print the margin of each design as one line of JSON, at the gains of the design file."""
    lower_share(19)
    from haptorb.cli.check_world import Setting, judge_world
    from haptorb.devices.loader import load

    given = loads(asked)
    candidates, motor = DesignChoice(**given["choice"]).load(), load(given["device"])
    factor = float(candidates.gains.torque_per_motion[0])
    for name in given["names"]:
        margin = judge_world(motor, candidates[name].world, Setting()).margin / factor
        # The parent reads each line as it is printed.
        os.write(sys.stdout.fileno(), f"{dumps(margin if math.isfinite(margin) else 1e9)}\n".encode())


if __name__ == "__main__":
    main(sys.argv[1])
