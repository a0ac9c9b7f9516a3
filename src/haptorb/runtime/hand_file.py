"""Motion of the simulated hand from a file: CSV, a script of moves, presses and waits, or a recording.

A CSV file has a line of column names with units, then a row for each time; straight lines connect the poses:

    t [s], x [mm], y [mm], z [mm], buttons, grip [mm]
    0,     0,      0,      62,     ,        40
    1.5,   0,      0,      48,     a,       20

A script has one command per line, and minimum-jerk motion like that of a hand (Flash and Hogan 1985):

    start 0 0 62 mm          # position at time zero; the first command
    move 0 0 48 mm in 1.5 s  # `line` instead of `move`: at constant speed
    press a                  # button a, b or c
    wait 300 ms
    release a
    turn 0 20 0 ° in 1 s     # orientation Rx Ry Rz; also after the position of `start`, `move` and `line`
    grip 20 mm in 0.2 s      # opening of the gripper

From a recording, the motion is the hand's goal in that run, or the pose of a real tool from its tracker.
"""

from __future__ import annotations

import csv
import hashlib
import io
import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import final

import numpy as np

from haptorb.arrays import Array
from haptorb.devices.base import Device
from haptorb.devices.quantity import si
from haptorb.errors import InputError, RecordingError, UnknownName, quote
from haptorb.file_kind import FileKind, find_kind
from haptorb.files import open_regular, read_text
from haptorb.runtime.shared_memory import BUTTONS
from haptorb.runtime.trackers.registry import has_feed
from haptorb.simulation.hand_motion import SampledPath, ScriptedMotion, handle_quaternions, upright_quaternions

__all__ = ["MAX_DURATION_S", "choose_hand", "parse_script", "parse_table", "read_hand"]

MAX_DURATION_S = 3600.0  #: duration of a motion [s]
_MAX_POSES = 1_000_000  #: poses of a motion
_MAX_TABLE_BYTES = 32 * 1024 * 1024  #: of a table
_MAX_NUMBER = 1e6  #: number of a table, in SI units
_MOVE_STEP_S = 1e-3  #: interval between the poses of a minimum-jerk move [s]


def read_hand(path: str | Path, device: Device) -> ScriptedMotion:
    """Read the motion in the file `path`, checked for `device`.

    Raises InputError with file and line for an invalid motion, or one that leaves the workspace; RecordingError for a
    damaged recording.
    """
    place = Path(path).expanduser()
    found = find_kind(place)
    if found is FileKind.RECORDING:
        return _read_recording(place, device)
    if found not in (None, FileKind.HAND, FileKind.TABLE):
        raise InputError(f"{FileKind.HAND.explain_found(place, found)}; a hand file is a script, CSV or a recording")
    text = read_text(place, "hand file", InputError, _MAX_TABLE_BYTES)
    digest = hashlib.sha256(text.encode()).hexdigest()
    is_table = found is FileKind.TABLE or (found is None and _looks_like_table(text))
    return (parse_table if is_table else parse_script)(text, device, str(path), digest)


def choose_hand(
    hand: str | Path | ScriptedMotion | None, device: Device, driver: str, tracker: str
) -> ScriptedMotion | None:
    """Return the given motion, or read that of the file of this name.

    Raises InputError on a real device, and with a tracker that determines the hand's pose; and as `read_hand`.
    """
    if hand is None:
        return None
    if driver != "sim":  # safety: hand-file-real
        raise InputError(
            f"a hand file moves a simulated hand, but driver '{driver}' acts on a real tool: leave out --hand"
        )
    if has_feed(tracker):
        raise InputError(
            f"tracker '{tracker}' determines where the hand is: a hand file needs tracker 'pointer' or 'hall'"
        )
    if isinstance(hand, ScriptedMotion):
        if not device.kind.modes:
            device.check_hand_goals(hand.path.poses[:, :3], hand.name or "the hand's path")
        return hand
    return read_hand(hand, device)


def _looks_like_table(text: str) -> bool:
    """Whether the first line names columns; then errors are reported as those of a table."""
    return bool(re.match(r"\s*\"?(?:t|time|tick)\b", text)) or "," in text.lstrip().partition("\n")[0]


def _make(
    path: str, device: Device, times: Array, poses: Array, presses: list[tuple[float, int]],
    grip: tuple[Array, Array] | None, digest: str,
) -> ScriptedMotion:  # fmt: skip
    """Make the motion along `poses` (n, 7) at `times` (n,), and check it for `device`.

    Positions are ignored for a motor, whose mover only rotates.
    """
    if times[-1] > MAX_DURATION_S:
        raise InputError(f"{path} lasts {times[-1]:g} s; a hand file lasts at most {MAX_DURATION_S:g} s")
    turns_only = bool(device.kind.modes)
    if turns_only:
        poses[:, :3] = 0.0
    else:
        device.check_hand_goals(poses[:, :3], path)
    motion = SampledPath(poses, times, math.inf)
    return ScriptedMotion(
        motion, presses=([t for t, _ in presses], [bits for _, bits in presses]), grip=grip, name=Path(path).name,
        digest=digest,
    )  # fmt: skip


def _orient(places: Array, device: Device) -> Array:
    """(n, 4) quaternions of a tool at `places` (n, 3) without a stated orientation: radial, or upright over a plate."""
    if device.is_upright:
        return np.tile([0.0, 0.0, 0.0, 1.0], (len(places), 1))
    return upright_quaternions(places)


# --------------------------------------------------------------------------------------------------
# Table: columns by name, with units.


#: column → (SI unit, meaning)
_QUANTITIES = {
    "t": ("s", "a time"),
    **dict.fromkeys("xyz", ("m", "a length")),
    **dict.fromkeys(("qx", "qy", "qz", "qw"), ("", "a plain number")),
    **dict.fromkeys(("psi", "lambda", "phi"), ("rad", "an angle")),
    "grip": ("m", "a length"),
    "buttons": ("", "buttons"),
}
_HEAD = re.compile(r"\s*([^\[\]]*?(?:\[\d\])?)\s*(?:\[\s*([^\[\]]*?)\s*\])?\s*")
#: columns of an exported recording → columns of a table; for a real device the pose of the tool
_EXPORTED = tuple(
    {"t": "t", "buttons": "buttons", "grip": "grip"}
    | {f"{place}[{i}]": name for i, name in enumerate("xyz")}
    | {f"{turn}[{i}]": f"q{name}" for i, name in enumerate("xyzw")}
    for place, turn in (("hand_goal", "hand_goal_q"), ("p", "q"))
)
_SEPARATORS = ",;\t"


def parse_table(text: str, device: Device, path: str, digest: str = "") -> ScriptedMotion:
    """Parse the motion in a CSV `text`; `path` is its name in messages. Raises InputError."""
    head = text.lstrip("\n").partition("\n")[0]
    separator = max(_SEPARATORS, key=head.count)
    if text.count("\n") > _MAX_POSES + 1:
        raise InputError(f"{path} has more than {_MAX_POSES} rows; at most 1000 per second are useful")
    reader = csv.reader(io.StringIO(text), delimiter=separator)
    try:
        heads = next((line for line in reader if any(cell.strip() for cell in line)), [])
        columns = _find_columns(heads, path)
        rows, numbers = [], []
        for line in reader:
            if any(cell.strip() for cell in line) and not line[0].lstrip().startswith("#"):
                rows.append(line)
                numbers.append(reader.line_num)
    except csv.Error as cause:
        raise InputError(f"{path} is not a table ({cause})") from cause
    if not rows:
        raise InputError(f"{path} has no rows under its line of column names")
    table = {
        name: _read_column(rows, numbers, at, name, unit, path)
        for name, (at, unit) in columns.items()
        if name != "buttons"
    }
    times = table["t"]
    _check_times(times, numbers, path)
    for name, values in table.items():
        usable = np.abs(values) < _MAX_NUMBER
        if name != "grip" and not usable.all():
            at = int(np.argmin(usable))
            raise InputError(
                f"{path}, line {numbers[at]}: {name} must be a finite number below {_MAX_NUMBER:g}; got "
                f"{quote(', '.join(rows[at]))}"
            )
    poses = np.zeros((len(rows), 7))
    if "x" in table:
        poses[:, :3] = np.column_stack([table[name] for name in "xyz"])
    if "qw" in table:
        poses[:, 3:] = np.column_stack([table[f"q{name}"] for name in "xyzw"])
        lengths = np.linalg.norm(poses[:, 3:], axis=1)
        if (np.abs(lengths - 1.0) > 0.01).any():
            at = int(np.argmax(np.abs(lengths - 1.0) > 0.01))
            raise InputError(f"{path}, line {numbers[at]}: qx, qy, qz, qw must be a quaternion of length 1")
    elif "psi" in table:
        poses[:, 3:] = handle_quaternions(np.column_stack([table[name] for name in ("psi", "lambda", "phi")]))
    else:
        poses[:, 3:] = _orient(poses[:, :3], device)
    presses: list[tuple[float, int]] = []
    if "buttons" in columns:
        column, last = columns["buttons"][0], 0
        for t, row, number in zip(times.tolist(), rows, numbers, strict=True):
            bits = _read_buttons(row[column] if column < len(row) else "", path, number)
            if bits != last:
                presses.append((t, bits))
                last = bits
    return _make(path, device, times, poses, presses, _read_grip(table, times, numbers, path), digest)


def _find_columns(heads: Sequence[str], path: str) -> dict[str, tuple[int, str | None]]:
    """Find name of each column → its index, and the unit in its heading; InputError for invalid columns."""
    stated: dict[str, tuple[int, str | None]] = {}
    for at, head in enumerate(heads):
        match = _HEAD.fullmatch(head)
        name = head.strip() if match is None else match[1]
        if name in stated:
            raise InputError(f"{path}: column {quote(name)} appears twice")
        stated[name] = at, None if match is None else match[2]
    for known in _EXPORTED:  # all others of an export are not the hand's
        if all(name in stated for name in known if name not in ("buttons", "grip")):
            return {ours: stated[name] for name, ours in known.items() if name in stated}
    for name in stated:
        if name not in _QUANTITIES:
            raise UnknownName(f"column of the hand file {path}", name, tuple(_QUANTITIES))
    for group in (("t",), ("x", "y", "z"), ("qx", "qy", "qz", "qw"), ("psi", "lambda", "phi")):
        lacking = [name for name in group if name not in stated]
        if lacking and (group == ("t",) or len(lacking) < len(group)):
            raise InputError(f"{path}: column {lacking[0]} is missing; a hand file has {', '.join(_QUANTITIES)}")
    if "qw" in stated and "psi" in stated:
        raise InputError(f"{path} states the orientation twice: use qx, qy, qz, qw or psi, lambda, phi")
    if not {"x", "qw", "psi"} & set(stated):
        raise InputError(f"{path} states no pose: it needs columns x, y, z, or an orientation, or both")
    return stated


def _read_column(rows: list[list[str]], numbers: list[int], at: int, name: str, stated: str | None, path: str) -> Array:
    """Read the numbers (n,) of a column in SI; an empty cell of `grip` is NaN."""
    unit, kind = _QUANTITIES[name]
    try:
        factor = 1.0 if stated in (None, "", "1") else si(f"1 {stated}", unit, kind)
    except ValueError as cause:
        raise InputError(f"{path}: column {name}: {cause}") from cause
    try:
        values = np.array([float(row[at]) if at < len(row) and row[at].strip() else math.nan for row in rows])
    except ValueError as cause:
        for row, line in zip(rows, numbers, strict=True):
            try:
                float(row[at] if at < len(row) and row[at].strip() else "nan")
            except ValueError:
                raise InputError(f"{path}, line {line}: {name} must be a number; got {quote(row[at])}") from cause
        raise
    return factor * values


def _check_times(times: Array, numbers: Sequence[int], path: str) -> None:
    """Raise InputError unless `times` [s] are finite, begin at 0 or later and increase."""
    wrong = ~np.isfinite(times)
    wrong[0] |= times[0] < 0.0
    wrong[1:] |= ~(np.diff(times) > 0.0)
    if wrong.any():
        at = int(np.argmax(wrong))
        before = f", after {times[at - 1]:g} s" if at else ""
        raise InputError(
            f"{path}, line {numbers[at]}: t must increase from row to row and begin at 0 s or later; got "
            f"{times[at]:g} s{before}"
        )


def _read_buttons(cell: str, path: str, line: int) -> int:
    """Parse pressed buttons to a sum of 1, 2 and 4: "", "a", "ab", "a+b", or the sum itself."""
    text = cell.strip().lower()
    names = re.sub(r"[+ ]", "", text)
    if all(letter in BUTTONS for letter in names) and len(set(names)) == len(names):
        return sum(1 << BUTTONS.index(letter) for letter in names)
    try:
        number = float(text)
    except ValueError:
        number = -1.0
    if math.isnan(number):
        return 0
    if number not in range(1 << len(BUTTONS)):
        raise InputError(
            f"{path}, line {line}: buttons are letters of {''.join(BUTTONS)} or their sum; got {quote(cell)}"
        )
    return int(number)


def _read_grip(table: dict[str, Array], times: Array, numbers: Sequence[int], path: str) -> tuple[Array, Array] | None:
    """Read times [s] and openings [m] of the gripper, where the table states them."""
    if "grip" not in table:
        return None
    opening = table["grip"]
    known = np.isfinite(opening)
    wrong = np.isinf(opening) | (known & ~((opening >= 0.0) & (opening <= _MAX_OPENING_M)))
    if wrong.any():
        at = int(np.argmax(wrong))
        raise InputError(
            f"{path}, line {numbers[at]}: grip must be between 0 and {1e3 * _MAX_OPENING_M:g} mm; "
            f"got {1e3 * opening[at]:g} mm"
        )
    return (times[known], opening[known]) if known.any() else None


_MAX_OPENING_M = 0.2  #: opening of a gripper between finger and thumb [m]


# --------------------------------------------------------------------------------------------------
# Recording: the goal of its hand, or the pose of its tool.


def _read_recording(path: Path, device: Device) -> ScriptedMotion:
    """Read the motion of the hand in the recording `path`."""
    from haptorb.recording.recording import Recording  # its file format takes 0.05 s that few runs need

    recording = Recording(path)
    recording.require("t", "valid", "hand_goal", "hand_goal_q", "p", "q")
    if len(recording) > _MAX_POSES:
        raise InputError(f"{path} has {len(recording)} rows; a hand file has at most {_MAX_POSES}: use a part of it")
    known = {field.name for field in recording.fields}
    t = np.asarray(recording["t"])
    poses = np.column_stack([recording["hand_goal"], recording["hand_goal_q"]])
    if not np.isfinite(poses).any():
        poses = np.column_stack([recording["p"], recording["q"]])
        poses[np.asarray(recording["valid"]) != 1.0] = np.nan
    usable = (np.abs(np.column_stack([t, poses])) < _MAX_NUMBER).all(axis=1)
    poses[~usable] = 0.0
    whole = usable & (np.abs(np.linalg.norm(poses[:, 3:], axis=1) - 1.0) < 0.01)
    if "commands" in known:
        whole &= ~(np.asarray(recording["commands"]) < 0.0)  # the last row repeats the previous one and is not a tick
    rows = np.flatnonzero(whole)
    if not rows.size:
        raise RecordingError(f"{path} holds no pose of a hand; record a run with --record")
    _check_times(t[rows], (rows + 1).tolist(), f"{path} (rows)")
    pressed = np.asarray(recording["buttons"])[rows] if "buttons" in known else np.zeros(len(rows))
    pressed = np.where(np.abs(pressed) < _MAX_NUMBER, pressed, 0.0).astype(np.int64) & 7
    changes = np.flatnonzero(np.diff(pressed, prepend=0))
    presses = [(float(t[rows[at]]), int(pressed[at])) for at in changes]
    table = {"grip": np.asarray(recording["grip"])[rows]} if "grip" in known else {}
    grip = _read_grip(table, t[rows], (rows + 1).tolist(), str(path))
    digest = hashlib.sha256()
    with open_regular(path, "recording", RecordingError) as file:
        while piece := file.read(1 << 20):
            digest.update(piece)
    return _make(str(path), device, t[rows], poses[rows], presses, grip, digest.hexdigest())


# --------------------------------------------------------------------------------------------------
# Script: one command per line.


_MAX_LINES = 10_000
_COMMAND_CHARACTERS = 200
_N = r"([-+]?(?:\d{1,40}(?:\.\d{0,40})?|\.\d{1,40})(?:e[-+]?\d{1,4})?)"
_UNIT = r"([^\s\d]\S*)"
_PLACE = rf"{_N}\s+{_N}\s+{_N}\s*{_UNIT}"
_TURN = rf"turn\s+{_N}\s+{_N}\s+{_N}\s*{_UNIT}"
_IN = rf"\s+in\s+{_N}\s*{_UNIT}"
_START = re.compile(rf"start(?:\s+{_PLACE})?(?:\s+{_TURN})?", re.IGNORECASE)
_MOVE = re.compile(rf"(move|line)(?:\s+{_PLACE})?(?:\s+{_TURN})?{_IN}", re.IGNORECASE)
_ONLY_TURN = re.compile(rf"{_TURN}{_IN}", re.IGNORECASE)
_WAIT = re.compile(rf"wait\s+{_N}\s*{_UNIT}", re.IGNORECASE)
_PRESS = re.compile(r"(press|release)((?:\s+[a-z])+)", re.IGNORECASE)
_GRIP = re.compile(rf"grip\s+{_N}\s*{_UNIT}(?:{_IN})?", re.IGNORECASE)
_FORMS = {
    "start": "start X Y Z UNIT [turn A B C UNIT]",
    "move": "move X Y Z UNIT [turn A B C UNIT] in T UNIT",
    "line": "line X Y Z UNIT [turn A B C UNIT] in T UNIT",
    "turn": "turn A B C UNIT in T UNIT",
    "wait": "wait T UNIT",
    "press": "press BUTTON …",
    "release": "release BUTTON …",
    "grip": "grip OPENING UNIT [in T UNIT]",
}


@final
class _Script:
    """State after each line: position, angles, time; and the knots so far."""

    def __init__(self) -> None:
        self.place: Array | None = None
        self.angles = np.zeros(3)
        self.turned = False  # the script states orientations: a position alone does not rotate the tool
        self.now = 0.0
        self.bits = 0
        self.opening = math.nan
        self.times: list[Array] = []
        self.knots: list[Array] = []  # (n, 6) place [m] and angles [rad]
        self.samples = 0
        self.presses: list[tuple[float, int]] = []
        self.grip: list[tuple[float, float]] = []

    def start(self, place: Array | None, angles: Array | None) -> None:
        """Set the pose at time zero."""
        if self.times:
            raise ValueError("start is the first command, and there is one")
        self.place = np.zeros(3) if place is None else place
        self.angles, self.turned = (np.zeros(3), False) if angles is None else (angles, True)
        self._add(np.zeros(1), np.concatenate((self.place, self.angles))[None])

    def move(self, place: Array | None, angles: Array | None, duration: float, *, smooth: bool) -> None:
        """Move within `duration` [s], with minimum jerk or, if not `smooth`, at constant speed."""
        before = np.concatenate((self._current_place(), self.angles))
        self.place = self._current_place() if place is None else place
        self.angles, self.turned = (self.angles, self.turned) if angles is None else (angles, True)
        after = np.concatenate((self.place, self.angles))
        count = max(math.ceil(duration / _MOVE_STEP_S - 1e-9), 1)
        if self.samples + count > _MAX_POSES:
            raise ValueError(f"the moves last longer than {_MAX_POSES * _MOVE_STEP_S:g} s together")
        s = np.arange(1, count + 1) / count
        share = s**3 * (10.0 + s * (6.0 * s - 15.0)) if smooth else s
        self._add(self.now + s * duration, before + share[:, None] * (after - before))

    def wait(self, duration: float) -> None:
        """Wait for `duration` [s]."""
        self._add(np.array([self.now + duration]), np.concatenate((self._current_place(), self.angles))[None])

    def press(self, names: Sequence[str], *, down: bool) -> None:
        """Press or release buttons now."""
        for name in names:
            if name not in BUTTONS:
                raise ValueError(f"there is no button {quote(name)}; there are {', '.join(BUTTONS)}")
            bit = 1 << BUTTONS.index(name)
            self.bits = self.bits | bit if down else self.bits & ~bit
        self._current_place()
        self.presses = [one for one in self.presses if one[0] != self.now] + [(self.now, self.bits)]

    def close_grip(self, opening: float, duration: float) -> None:
        """Move the gripper to `opening` [m] within `duration` [s]."""
        if not 0.0 <= opening <= _MAX_OPENING_M:
            raise ValueError(f"grip must be between 0 and {1e3 * _MAX_OPENING_M:g} mm")
        self._current_place()
        if duration and not math.isnan(self.opening):
            self.grip.append((self.now, self.opening))
        if duration:
            self.wait(duration)
        self.grip.append((self.now, opening))
        self.opening = opening

    def _current_place(self) -> Array:
        if self.place is None:
            raise ValueError(f"the first command must be {_FORMS['start']}")
        return self.place

    def _add(self, times: Array, knots: Array) -> None:
        if times[-1] > MAX_DURATION_S:
            raise ValueError(f"the script lasts longer than {MAX_DURATION_S:g} s")
        times = times.round(9)  # a sum of decimals is that decimal again
        self.now = float(times[-1])
        self.times.append(times)
        self.knots.append(knots)
        self.samples += len(times)


def parse_script(text: str, device: Device, path: str, digest: str = "") -> ScriptedMotion:
    """Parse the motion in a script `text`; `path` is its name in messages. Raises InputError."""
    script, lines = _Script(), text.split("\n")
    if len(lines) > _MAX_LINES:
        raise InputError(f"{path} has more than {_MAX_LINES} lines; a longer motion is a CSV file")
    for number, line in enumerate(lines, start=1):
        words = line.partition("#")[0].strip()
        if not words:
            continue
        try:
            _execute(script, words)
        except ValueError as cause:
            raise InputError(f"{path}, line {number}: {cause}; got {quote(words)}") from cause
    if not script.times:
        raise InputError(f"{path} is empty; the first command is {_FORMS['start']}")
    times, knots = np.concatenate(script.times), np.concatenate(script.knots)
    poses = np.zeros((len(times), 7))
    poses[:, :3] = knots[:, :3]
    if script.turned or device.kind.modes:
        poses[:, 3:] = handle_quaternions(knots[:, 3:])
    else:
        poses[:, 3:] = _orient(poses[:, :3], device)
    grip = np.array(script.grip).reshape(-1, 2)
    stated = (grip[:, 0], grip[:, 1]) if script.grip else None
    return _make(path, device, times, poses, script.presses, stated, digest)


def _execute(script: _Script, words: str) -> None:
    """Append the command `words` to `script`; ValueError if it is not a command."""
    if len(words) > _COMMAND_CHARACTERS:
        raise ValueError(f"a command has at most {_COMMAND_CHARACTERS} characters")
    if (match := _START.fullmatch(words)) is not None and words.lower() != "start":
        script.start(_read_three(match.groups()[:4], "m"), _read_three(match.groups()[4:8], "rad"))
    elif (match := _MOVE.fullmatch(words)) is not None and (match[2] or match[6]):
        place, angles = _read_three(match.groups()[1:5], "m"), _read_three(match.groups()[5:9], "rad")
        script.move(place, angles, _read_duration(match[10], match[11]), smooth=match[1].lower() == "move")
    elif (match := _ONLY_TURN.fullmatch(words)) is not None:
        angles = _read_three(match.groups()[:4], "rad")
        script.move(None, angles, _read_duration(match[5], match[6]), smooth=True)
    elif (match := _WAIT.fullmatch(words)) is not None:
        script.wait(_read_duration(match[1], match[2]))
    elif (match := _PRESS.fullmatch(words)) is not None:
        script.press(match[2].lower().split(), down=match[1].lower() == "press")
    elif (match := _GRIP.fullmatch(words)) is not None:
        duration = _read_duration(match[3], match[4]) if match[3] else 0.0
        script.close_grip(si(f"{match[1]} {match[2]}", "m", "a length"), duration)
    else:
        name = words.split()[0].lower()
        form = _FORMS.get(name)
        raise ValueError(f"{name} is written `{form}`" if form else f"a command is one of {', '.join(_FORMS)}")


def _read_three(cells: Sequence[str | None], unit: str) -> Array | None:
    """Parse (3,) numbers with one unit to SI; None if they are missing."""
    *numbers, stated = cells
    if stated is None:
        return None
    kind = "a length" if unit == "m" else "an angle"
    return np.array([si(f"{number} {stated}", unit, kind) for number in numbers])


def _read_duration(number: str, unit: str) -> float:
    """Parse a positive duration [s]."""
    duration = si(f"{number} {unit}", "s", "a duration")
    if not 0.0 < duration <= MAX_DURATION_S:
        raise ValueError(f"a duration must be above 0 and at most {MAX_DURATION_S:g} s")
    return duration
