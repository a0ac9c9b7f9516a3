"""How strong the designs of a feel session may be felt: what the stability check allows, and the device's limit.

The check looks all over the workspace and takes seconds per design, so it runs in a process of its own, with low
priority, while the first design is felt.
"""

from __future__ import annotations

import math
import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import asdict
from json import JSONDecodeError, dumps, loads
from typing import TYPE_CHECKING, final

from haptorb.apps.cli.feel_session.choice import DesignChoice
from haptorb.runtime.realtime.process_starter import start_python

if TYPE_CHECKING:
    from haptorb.apps.feel import Candidate
    from haptorb.apps.feel.true_scale import ScaleLimits, TrueScale

__all__ = ["StabilityCheck", "find_limits"]


@final
class StabilityCheck:
    """The check of the designs `names` of `choice` on `device`, on its way; `close` ends it."""

    def __init__(self, choice: DesignChoice, device: str, names: Sequence[str]) -> None:
        self._count = len(names)
        asked = dumps({"choice": asdict(choice), "device": device, "names": list(names)})
        self._process = start_python(
            "haptorb.apps.cli.feel_session.limits", asked,
            stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, stdin=subprocess.DEVNULL,
        )  # fmt: skip

    def wait(self) -> float | None:
        """The smallest margin of all designs: so many times stronger, the loop oscillates. None: it did not end."""
        out, _ = self._process.communicate()
        try:
            margins = [float(loads(line)) for line in out.splitlines()]
        except (JSONDecodeError, TypeError, ValueError):
            return None
        return min(margins) if len(margins) == self._count else None

    def close(self) -> None:
        """End it; a `wait` in another thread returns."""
        self._process.kill()


def find_limits(scale: TrueScale, designs: Sequence[Candidate], margin: float | None) -> ScaleLimits:
    """The limits for `designs`, whose smallest stability `margin` is known, or None.

    At the largest gain the loop still stands `check.ENOUGH` times more, and the greatest computed force is what the
    device can give.
    """
    from haptorb.apps.check.world import ENOUGH
    from haptorb.apps.feel import course
    from haptorb.apps.feel.true_scale import ScaleLimits

    peaks = [max(run.going_in.max(), run.coming_out.max()) for run in map(course, designs)]
    full = scale.find_saturation(float(max(peaks)))
    if margin is None:
        return ScaleLimits(1.0, "the stability check did not finish", scale.hand_per_part)
    stable = margin / ENOUGH
    if stable < full:
        reason = f"in a light grip it oscillates from {margin:.3g}; the stability check keeps a factor of {ENOUGH:g}"
    else:
        reason = (
            f"at that gain the device reaches its limit of {scale.limit:g} N·m at the greatest force "
            f"({max(peaks):.1f} N)"
        )
    found = min(stable, full)
    if found < 1.0:
        reason = f"the gain in the design file is above the largest possible one, {found:.2g}: {reason}"
    return ScaleLimits(max(found, 1.0), reason, scale.hand_per_part)


def main(asked: str) -> None:
    """Print the margin of each design as JSON, one line each, at the gains of the design file."""
    os.nice(19)
    from haptorb.apps.check import Setting, judge_world
    from haptorb.devices.loader import load

    given = loads(asked)
    candidates, motor = DesignChoice(**given["choice"]).load(), load(given["device"])
    factor = float(candidates.gains.torque_per_motion[0])
    for name in given["names"]:
        margin = judge_world(motor, candidates[name].world, Setting()).margin / factor
        # The parent reads a line as soon as it is there.
        os.write(sys.stdout.fileno(), f"{dumps(margin if math.isfinite(margin) else 1e9)}\n".encode())


if __name__ == "__main__":
    main(sys.argv[1])
