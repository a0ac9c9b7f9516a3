"""Trip reasons, each with a code for recordings, a sentence and the remedy; states of guard and coils."""

from __future__ import annotations

from enum import IntEnum

__all__ = ["CoilState", "GuardState", "Trip"]


class GuardState(IntEnum):
    """State of the guard; the numbers are stored in recordings and never change."""

    OFF = 0
    RAMPING = 1
    RUNNING = 2
    DERATED = 3
    TRIPPED = 4


class CoilState(IntEnum):
    """Confirmed by the device: whether current can flow.

    The numbers are stored in recordings and never change.

    Attributes
    ----------
    OFF : int
        0, confirmed by the device.
    ON : int
        1, current can flow.
    UNKNOWN : int
        2, after a command to switch off that the device has not confirmed yet.
    """

    OFF = 0
    ON = 1
    UNKNOWN = 2


class Trip(IntEnum):
    """Reasons for a trip; the numbers are stored in recordings and never change."""

    NONE = 0
    STOPPED = 1
    POSE_LOST = 2
    POSE_EXPIRED = 3
    WORLD_NOT_FINITE = 4
    WORLD_FAILED = 5
    CURRENTS_NOT_FINITE = 6
    SAMPLE_NOT_FINITE = 7
    OVERHEATED = 8
    OVERCURRENT = 9
    HOST_SILENT = 10
    DRIVER_FAILED = 11
    CLOSING = 12
    LOOP_FAILED = 13
    MAGNET_REVERSED = 14
    OVERRUN = 15
    CURRENT_MISMATCH = 16
    MEMORY_NOT_FINITE = 17

    @property
    def text(self) -> str:
        """One sentence: cause and remedy.

        >>> Trip.STOPPED.text
        'Stopped by hand. Re-engage when you are ready.'
        """
        return _TEXT[self]


_TEXT = {
    Trip.NONE: "",
    Trip.STOPPED: "Stopped by hand. Re-engage when you are ready.",
    Trip.POSE_LOST: "The tracker lost the mover. Bring it back into view, then re-engage.",
    Trip.POSE_EXPIRED: "No new pose arrived in time. Check the tracker or the page that sends it, then re-engage.",
    Trip.WORLD_NOT_FINITE: "The world returned a wrench that is not finite. Fix the world, then re-engage.",
    Trip.WORLD_FAILED: "The world's code failed. Fix the world or choose another, then re-engage.",
    Trip.CURRENTS_NOT_FINITE: "The allocator computed currents that are not finite. Please report it, then re-engage.",
    Trip.SAMPLE_NOT_FINITE: "A sensor reading is not finite. Check the sensors, then re-engage.",
    Trip.OVERHEATED: "A winding is too hot. Let it cool below the derating temperature, then re-engage.",
    Trip.OVERCURRENT: "A coil's current is above its limit. Check driver and wiring before you re-engage.",
    Trip.HOST_SILENT: "The host program stopped responding. Start it again.",
    Trip.DRIVER_FAILED: "The device did not respond. Check cable and supply, then re-engage.",
    Trip.CLOSING: "The servo is closing.",
    Trip.LOOP_FAILED: "The servo failed; its report gives the reason. Start it again.",
    Trip.MAGNET_REVERSED: (
        "The tool's magnet is reversed, or the tool is upside down: every force would invert. Turn it over, then "
        "re-engage."
    ),
    Trip.OVERRUN: (
        "The loop missed its deadlines: the computer is too busy, its process was stopped, or a tick takes too long. "
        "Close other programs, reduce the loop rate or simplify the world, then re-engage."
    ),
    Trip.MEMORY_NOT_FINITE: (
        "The world's memory is no longer finite. Fix the world or choose another, then re-engage: it starts again."
    ),
    Trip.CURRENT_MISMATCH: (
        "A coil's measured current does not match its voltage. Check the coil, its current sensor and its driver, "
        "then re-engage."
    ),
}
