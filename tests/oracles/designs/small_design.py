"""Design of the Omni that computes in milliseconds, with all kinds of parameter, and functions of its own."""

from __future__ import annotations

from pathlib import Path

from haptorb_design.design_file import load_design
from haptorb_design.problem import Design

__all__ = ["BARE", "CODE", "TEXT", "make_design", "write_design"]

#: The base: an Omni whose coils have no sizes, so that a small dome does not meet them
BARE = """
based_on = "omni"
name = "bare"
drop = ["windings", "hall.range"]
[coils]
inductance = ["0.4 mH", "0.4 mH", "0.4 mH"]
"""

TEXT = """
name = "small"
base = "bare.toml"

[parameters.radius]
low = "26 mm"
high = "34 mm"
places = ["dome.radius"]

[parameters.angle]
low = "50 deg"
high = "70 deg"
step = "5 deg"
places = ["dome.workspace_half_angle"]

[parameters.shell]
choices = { thin = "10 mm", thick = "20 mm" }
places = ["dome.shell_thickness"]

[objectives.cost]
function = "own.py:cost"
unit = "m"

[objectives.reach]
function = "own.py:reach"
sense = "maximise"

[constraints.room]
function = "own.py:room"
unit = "m"
at_most = "31 mm"
"""

CODE = '''
def cost(candidate):
    """Radius of the dome, and a tenth of its shell."""
    return candidate.device.shell.dome_radius + 0.1 * candidate.device.shell.thickness

def reach(candidate):
    return candidate.device.workspace_half_angle

def room(candidate):
    return candidate.share("room", lambda: candidate.device.shell.dome_radius)
'''


def write_design(folder: Path, text: str = TEXT, code: str = CODE) -> Path:
    """The design's files in `folder`; the path of the design file."""
    (folder / "own.py").write_text(code, encoding="utf-8")
    (folder / "bare.toml").write_text(BARE, encoding="utf-8")
    path = folder / "small.toml"
    path.write_text(text, encoding="utf-8")
    return path


def make_design(folder: Path, text: str = TEXT, code: str = CODE) -> Design:
    """The design, from files in `folder`."""
    return load_design(write_design(folder, text, code))
