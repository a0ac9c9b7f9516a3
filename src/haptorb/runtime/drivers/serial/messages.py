"""Why the firmware lets no current flow, in one clause: from what it says to what a person reads."""

from __future__ import annotations

from haptorb.runtime.drivers.serial.codes import BoardMode, Reason, Refusal, missing_chips
from haptorb.runtime.drivers.serial.reading import Reading
from haptorb.runtime.drivers.serial.replies import BoardState

__all__ = ["explain_off", "refusal"]

_WARM = 0xE0  #: bits of the thermometers
_NEEDED = 0x0F  #: bits of the parts without which nothing is driven


def explain_off(reading: Reading, engaged: bool) -> str:
    """A trip, or an unrequested restart while the host took it for `engaged`; empty if neither.

    >>> from haptorb.runtime.drivers.serial.reading import make_reading
    >>> explain_off(Reading.of(make_reading()), engaged=True)
    'the firmware is off without a command: no reason'
    """
    if reading.mode is BoardMode.TRIPPED:
        parts = missing_chips(reading.missing & _NEEDED) if reading.reason is Reason.CHIP else ()
        detail = f": {', '.join(parts)}" if parts else ""
        return f"the firmware switched the coils off: {reading.reason.text}{detail}"
    if engaged and reading.mode is BoardMode.OFF:  # safety: firmware-restarted
        return f"the firmware is off without a command: {reading.reason.text}"
    return ""


def refusal(state: BoardState) -> str:
    """Why it did not take the command that it answers with `state`; empty if it did."""
    if state.refusal is Refusal.ACCEPTED:
        return ""
    reasons = {
        Refusal.STOP_BUTTON: Reason.STOP_BUTTON.text,
        Refusal.CHIP: "not ready: " + (", ".join(missing_chips(state.missing & _NEEDED)) or "try again"),
        Refusal.TRIPPED: f"it tripped: {state.reason.text}",
        Refusal.HOT: Reason.HOT.text,
        Refusal.THERMOMETER: "the coil temperature is unknown: "
        + (", ".join(missing_chips(state.missing & _WARM)) or "a thermometer")
        + " has sent nothing for 4 s (check its wire; after a restart wait two seconds)",
        Refusal.WRITING: "its calibration is being written (try again)",
        Refusal.EEPROM: "its EEPROM does not store data: the chip may be worn out",
    }
    return reasons.get(state.refusal, state.refusal.name)
