"""Does the calibration that is believed belong to the device that answers? What to say where they disagree."""

from __future__ import annotations

__all__ = ["disagreement"]


def disagreement(stored: bytes | None, believed: bytes | None) -> str:
    """One sentence about the ids that the device keeps and that the controller's calibration has; empty if they agree.

    `stored` None: the device has no memory; zeros: it keeps none. `believed` None: no calibration was given.

    >>> disagreement(bytes(16), None), disagreement(None, b"x" * 16)
    ('', '')
    """
    if stored is None or stored == (believed or bytes(16)):
        return ""
    if believed is None:
        return (
            f"the device was calibrated (id {stored.hex()}) and no calibration is believed: give its file with "
            "--calibration"
        )
    if not any(stored):
        return (
            f"the device keeps no calibration, the file is {believed.hex()}: was it measured on this very device? "
            "`haptorb calibrate` stores its id"
        )
    return (
        f"the calibration {believed.hex()} is not the one that the device keeps, {stored.hex()}: take the file "
        "that was measured last on this very device, or calibrate again"
    )
