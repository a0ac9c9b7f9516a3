"""What a page may ask of a feel session."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from haptorb.errors import InputError, UnknownName, quote

if TYPE_CHECKING:
    from haptorb.apps.feel.live_session import LiveSession

__all__ = ["check_slot", "execute_command"]

_SLOTS = ("a", "b")


def execute_command(live: LiveSession, command: Mapping[str, Any]) -> None:
    """What a page asks for: {"act": NAME, ...}. Raises InputError for what cannot be."""
    match command.get("act"):
        case "rate":
            live.rate(command.get("score"), str(command.get("feeling", "")))
        case "next":
            live.feel_next()
        case "feel":
            live.feel(live.design_of(command.get("number")))
        case "slot":
            live.feel_slot(check_slot(command.get("slot")))
        case "pair":
            live.set_pair(check_slot(command.get("slot")), live.design_of(command.get("number")))
        case "person":
            live.set_person(str(command.get("person", "")))
        case "hide":
            live.set_blind(command.get("hide") is True)
        case "scale":
            live.set_scale(command.get("scale"))
        case "finish":
            live.finish()
        case other:
            known = "rate, next, feel, slot, pair, person, hide, scale, finish"
            raise InputError(f"unknown act {quote(other)} of a feel session (known: {known})")


def check_slot(slot: object) -> str:
    """`slot` itself, "a" or "b"; UnknownName for anything else."""
    if slot not in _SLOTS:
        raise UnknownName("slot", str(slot)[:20], _SLOTS)
    return str(slot)
