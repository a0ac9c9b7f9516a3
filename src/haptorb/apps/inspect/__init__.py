"""`haptorb inspect`: capability cards of one device or several, as text, as numbers and as a picture."""

from __future__ import annotations

from haptorb.apps.inspect.card import Card, card
from haptorb.apps.inspect.comparison import Comparison, name_devices

__all__ = ["Card", "Comparison", "card", "name_devices"]
