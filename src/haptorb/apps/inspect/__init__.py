"""`haptorb inspect DEVICE`: the capability card of a device, as text, as numbers and as a picture."""

from __future__ import annotations

from haptorb.apps.inspect.card import Card, card

__all__ = ["Card", "card"]
