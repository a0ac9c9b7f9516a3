"""The HTTP routes of that service: version, devices, sessions, settings, and the config of a device."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any
from urllib.parse import parse_qs, unquote, urlsplit

from haptorb.apps.serve.haply.http_exchange import HttpReply
from haptorb.apps.serve.haply.inventory import Settings
from haptorb.apps.serve.haply.service import Service
from haptorb.apps.serve.haply.session import Session
from haptorb.apps.serve.haply.space import default_space
from haptorb.errors import HaptorbError
from haptorb.version import __version__

__all__ = ["reply"]

_PROTOCOL = "3.5.0"  #: of the service whose documentation this follows
_GRIP = "wireless_verse_grip"
_CONFIG = ("basis", "preset", "mount", "workspace", "filters", "damping", "force_gate", "handedness", "navigation",
           "torque_scaling", "gravity_compensation", "home_return")  # fmt: skip


def reply(service: Service, method: str, target: str, body: bytes) -> HttpReply:
    """The answer of `service` to a request; errors are {ok: false, error}."""
    parts = urlsplit(target)
    query = parse_qs(parts.query)
    words = [unquote(word) for word in parts.path.split("/") if word]
    found = _route(service, method, words, query, body)
    if query.get("format") == ["json"] and found.status < 400:
        return HttpReply(found.status, {"ok": True, "error": None, "data": found.body})
    return found


def _route(service: Service, method: str, words: list[str], query: Mapping[str, list[str]], body: bytes) -> HttpReply:
    if method == "GET" and len(words) == 1:
        match words[0]:
            case "version":
                return HttpReply(200, {"version": _PROTOCOL, "service": f"haptorb {__version__}"})
            case "devices":
                return HttpReply(200, _list_devices(service))
            case "sessions":
                return HttpReply(
                    200, {"sessions": [_describe_session(service, one) for one in service.sessions.values()]}
                )
            case "settings":
                return HttpReply(200, {"settings": {}})
    if len(words) in (3, 4) and words[2] == "config":
        return _route_config(service, method, words, query, body)
    if words and words[-1] in _CONFIG and len(words) < 3:
        service.tell("http-route-deprecated", "http", "warning", {"route": "/".join(words)[:100]})
        return _refuse(404, f"'{words[-1]}' is now at another route: /inverse3/0/config/{words[-1]}")
    return _refuse(404, "no such route; known: /version, /devices, /sessions, /settings and /TYPE/ID/config/NAME")


def _route_config(
    service: Service, method: str, words: list[str], query: Mapping[str, list[str]], body: bytes
) -> HttpReply:
    kind, which = words[0], words[1]
    ids = {"inverse3": service.identity.device, _GRIP: service.identity.grip}
    if kind not in ids or which.upper() not in ("0", "*", ids[kind]):
        return _refuse(404, f"no device {kind}/{which}; there is inverse3/{ids['inverse3']} and {_GRIP}/{ids[_GRIP]}")
    name = words[3] if len(words) == 4 else ""
    if name and (name not in _CONFIG or kind == _GRIP):
        return _refuse(404, f"{kind} has no config '{name}'; inverse3 has {', '.join(_CONFIG)}")
    session, refusal = _find_session(service, query.get("session", []))
    if refusal:
        return _refuse(404, refusal)
    try:
        if method == "POST" and name:
            service.configure(session, {name: json.loads(body)})
        elif method == "DELETE" and name:
            _restore(service, session, name)
        elif method != "GET":
            return _refuse(405, f"{method} is not allowed for this route")
    except HaptorbError as cause:
        return _refuse(400, str(cause))
    except (ValueError, RecursionError) as cause:
        return _refuse(400, f"the body is not JSON: {str(cause)[:200]}")
    config: dict[str, Any] = {"type": kind, "handedness": "right"}
    if kind == "inverse3":
        config = _describe_config(service, session)
    if not name:
        return HttpReply(200, config)
    found = config["filters"][name] if name in config["filters"] else config.get(name, {})
    return HttpReply(200, found if isinstance(found, Mapping) else {name: found})


def _restore(service: Service, session: Session | None, name: str) -> None:
    """What `name` is without anybody's word."""
    first = default_space(service.served.device)
    config = Settings().as_json(service.identity, first)
    found = config["filters"].get(name, config.get(name))
    if found is not None and name not in ("torque_scaling", "gravity_compensation", "home_return"):
        service.configure(session, {name: found})
        if name == "mount":
            service.configure(session, {"preset": first.preset})


def _find_session(service: Service, given: list[str]) -> tuple[Session | None, str]:
    """The session that ?session= means, by `:INDEX` or id; None: all that connect from now on."""
    if not given or given[0] == "*":
        return None, ""
    text, sessions = given[0], list(service.sessions.values())
    for at, session in enumerate(sessions):
        if text in (f":{at}", str(session.number)):
            return session, ""
    return None, f"no session {text[:40]}; there are {len(sessions)}: /sessions lists them"


def _describe_session(service: Service, session: Session) -> dict[str, Any]:
    return {
        "session_id": session.number,
        "profile": {"name": session.name},
        "rate_hz": round(session.rate, 1),
        "holds": service.served.holder == session.number,
    }


def _describe_config(service: Service, session: Session | None) -> dict[str, Any]:
    return service.settings.as_json(service.identity, service.space if session is None else session.space)


def _list_devices(service: Service) -> dict[str, Any]:
    service.cursor.look()
    return {
        "inverse3": [{"device_id": service.identity.device, "config": _describe_config(service, None)}],
        "verse_grip": [],
        _GRIP: [{"device_id": service.identity.grip}],
        "custom_verse_grip": [],
    }


def _refuse(status: int, why: str) -> HttpReply:
    return HttpReply(status, {"ok": False, "error": why})
