"""Panel of a feel session in the console page: its state and its commands."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, final

from haptorb.errors import InputError, quote
from haptorb_study.feel.live_session import LiveSession, check_slot

__all__ = ["FeelPanel"]


@final
class FeelPanel:
    """Adapter of `live` to the console (`console_hub.DesignSession`)."""

    def __init__(self, live: LiveSession) -> None:
        self._live = live

    @property
    def version(self) -> int:
        """Changes with every state change."""
        return self._live.version

    @property
    def hidden(self) -> bool:
        """Whether name, values and picture of the design are hidden from every page."""
        return self._live.hidden

    def describe(self) -> dict[str, Any]:
        """State for the page as plain JSON types."""
        return self._live.describe()

    def execute(self, command: Mapping[str, Any]) -> None:
        """Execute a page's command: {"act": NAME, ...}. Raises InputError for invalid commands."""
        live = self._live
        match command.get("act"):
            case "rate":
                live.rate(command.get("score"), _text(command, "feeling"))
            case "next":
                live.feel_next()
            case "feel":
                live.feel(live.design_of(command.get("number")))
            case "slot":
                live.feel_slot(check_slot(command.get("slot")))
            case "pair":
                live.set_pair(check_slot(command.get("slot")), live.design_of(command.get("number")))
            case "person":
                live.set_person(_text(command, "person"))
            case "hide":
                live.set_blind(command.get("hide") is True)
            case "scale":
                live.set_scale(command.get("scale"))
            case "finish":
                live.finish()
            case other:
                known = "rate, next, feel, slot, pair, person, hide, scale, finish"
                raise InputError(f"unknown act {quote(other)} of a feel session (known: {known})")


def _text(command: Mapping[str, Any], name: str) -> str:
    value = command.get(name, "")
    if not isinstance(value, str):
        raise InputError(f"{name} must be a text; got {quote(value)}")
    return value
