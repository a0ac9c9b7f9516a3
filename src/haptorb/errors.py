"""The exceptions of haptorb, as one tree: catch them at any level.

    HaptorbError
    ├── InputError           a number, unit or shape that cannot be used
    │   ├── GeometryError    parts that overlap, points where a quantity is not defined
    │   └── UnknownName      a device, world, key or model that does not exist (similar names suggested)
    ├── DeviceError          a device file that does not describe a device
    ├── PrecisionError       the requested precision was not reached (the best one is stated)
    ├── CalibrationError     measurements that contradict the device file (the part is named)
    ├── DriverError          hardware or simulation that does not respond correctly
    │   └── HostSilent       the hardware switched off because this computer was silent
    ├── RecordingError       a recording that cannot be written or read
    ├── ServoError           the real-time process did not start, or ended unexpectedly
    │   └── WorldError       the loop runs, but a world's code failed or takes too long: coils off
    └── PlatformError        not available on this operating system (alternatives are stated)

Every message states what happened, where, what was expected and what to do.
"""

from __future__ import annotations

import reprlib
from collections.abc import Iterable
from difflib import get_close_matches

__all__ = [
    "CalibrationError",
    "DeviceError",
    "DriverError",
    "GeometryError",
    "HaptorbError",
    "HostSilent",
    "InputError",
    "PlatformError",
    "PrecisionError",
    "RecordingError",
    "RecordingWarning",
    "ServoError",
    "UnknownName",
    "WorldError",
    "quote",
]


class _Short(reprlib.Repr):
    """`reprlib.Repr` that also shortens integers with many digits."""

    def __init__(self) -> None:
        super().__init__()
        self.maxlevel, self.maxother, self.maxlist, self.maxtuple, self.maxdict = 3, 60, 6, 6, 4

    def repr_int(self, x: int, level: int) -> str:
        """Format all digits, or only their number if there are many."""
        return repr(x) if x.bit_length() < 200 else f"an integer of {int(x.bit_length() * 0.30103) + 1} digits"

    def repr_str(self, x: str, level: int) -> str:
        """Escape the text, and shorten it if it is long."""
        return repr(x) if len(x) <= self.maxstring else f"{x[: self.maxstring]!r} and {len(x) - self.maxstring} more"


def quote(value: object, most: int = 60) -> str:
    """Return `value` for a message: one line without control characters, texts of at most `most` characters.

    >>> quote("1 m"), quote("a\\nb"), quote(10**400)
    ("'1 m'", "'a\\\\nb'", 'an integer of 401 digits')
    """
    short = _Short()
    short.maxstring = most
    return short.repr(value)


class HaptorbError(Exception):
    """Base class of all errors that haptorb can explain; commands print them without a traceback.

    Parameters
    ----------
    message : str
        What happened, where, what was expected and what to do.
    command : str
        The same message for the command line, if an option has another name there.

    Attributes
    ----------
    command_message : str
        What the command line prints.

    Examples
    --------
    >>> error = HaptorbError("x exists: overwrite=True replaces it", command="x exists: --force replaces it")
    >>> str(error), error.command_message
    ('x exists: overwrite=True replaces it', 'x exists: --force replaces it')
    """

    def __init__(self, message: str = "", *, command: str = "") -> None:
        super().__init__(message)
        self.command_message = command or message


class InputError(HaptorbError, ValueError):
    """A number, unit or shape that cannot be used."""


class GeometryError(InputError):
    """Parts that overlap, or a point at which the requested quantity is not defined."""


class UnknownName(InputError):
    """A name that is not in the list of valid names; the message suggests the most similar one.

    Parameters
    ----------
    what : str
        What the name stands for, such as "world".
    name : str
        The unknown name.
    known : iterable of str
        The valid names.

    Examples
    --------
    >>> print(UnknownName("world", "dme", ["dome", "none"]))
    unknown world 'dme'; did you mean 'dome'? (known: dome, none)
    """

    def __init__(self, what: str, name: str, known: Iterable[str]) -> None:
        names = sorted(known)
        near = get_close_matches(name[:100], names, n=1, cutoff=0.5)
        hint = f"; did you mean '{near[0]}'?" if near else ""
        colon = ":" if what.endswith("'") else ""  # two names side by side cannot be distinguished
        super().__init__(f"unknown {what}{colon} {quote(name)}{hint} (known: {', '.join(names)})")


class DeviceError(HaptorbError):
    """A device file that does not describe a device."""


class PrecisionError(HaptorbError):
    """The requested precision was not reached; the message states the best that was."""


class CalibrationError(HaptorbError):
    """Measurements that contradict the device file; the message names the part and what to check."""


class DriverError(HaptorbError):
    """Hardware, or its simulation, that does not respond correctly."""


class HostSilent(DriverError):
    """The hardware switched off because this computer was silent for a moment; no fault."""


class RecordingError(HaptorbError):
    """A recording that cannot be written or read."""


class RecordingWarning(UserWarning):
    """A recording is damaged: the message states which rows are missing; all others can be read."""


class ServoError(HaptorbError):
    """The real-time process did not start, or ended unexpectedly."""


class WorldError(ServoError):
    """A world's code failed, or takes longer than a tick, and the coils are off; the message states file and line."""


class PlatformError(HaptorbError):
    """This needs Linux; the message states what works on other systems."""
