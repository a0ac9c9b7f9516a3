"""Does the calibration in use belong to the device that responds? The message where they disagree."""

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
            f"the device was calibrated (id {stored.hex()}), but no calibration is loaded: load its file with "
            "--calibration FILE, or calibration=FILE in Python"
        )
    if not any(stored):
        return (
            f"the device stores no calibration id, the file has {believed.hex()}: check that it was measured on this "
            "device; `haptorb calibrate` stores the id"
        )
    return (
        f"calibration {believed.hex()} is not the one stored on the device, {stored.hex()}: use the last file "
        "measured on this device, or calibrate again"
    )
