"""The HTTP routes of that service: version, devices, sessions, settings, and the config of a device."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any
from urllib.parse import parse_qs, unquote, urlsplit

from haptorb.apps.serve.haply.http_exchange import HttpReply
from haptorb.apps.serve.haply.inventory import Settings
from haptorb.apps.serve.haply.selectors import TOOL, AmbiguousDevice, find_kind, find_session
from haptorb.apps.serve.haply.service import Service
from haptorb.apps.serve.haply.session import Session
from haptorb.apps.serve.haply.space import Space, default_space
from haptorb.errors import HaptorbError, InputError
from haptorb.version import __version__

__all__ = ["reply"]

_PROTOCOL = "3.5.0"  #: of the service whose documentation this follows
_FIXED = ("torque_scaling", "gravity_compensation", "home_return")  #: what this device cannot be made to do
_CONFIG = ("basis", "preset", "mount", "transform", "workspace", "filters", "damping", "force_gate", "handedness",
           "navigation", *_FIXED)  # fmt: skip
_OLD = {"device_handedness": "handedness"}  #: routes of version 3.0 whose names differ
_OLDER = ("3.1", "3.0")  #: that some programs write before a route


def reply(service: Service, method: str, target: str, body: bytes) -> HttpReply:
    """The answer of `service` to a request: of /version and /devices as they are, of all others {ok: true, data}.

    Errors are {ok: false, error}.
    """
    parts = urlsplit(target)
    query = parse_qs(parts.query)
    words = [unquote(word) for word in parts.path.split("/") if word]
    if words and words[0] in _OLDER:
        del words[0]
    try:
        return _route(service, method, words, query, body)
    except AmbiguousDevice as cause:
        return _refuse(400, str(cause))
    except InputError as cause:
        return _refuse(404, str(cause))


def _route(service: Service, method: str, words: list[str], query: Mapping[str, list[str]], body: bytes) -> HttpReply:
    if method == "GET" and len(words) == 1:
        match words[0]:
            case "version":
                return HttpReply(200, _describe_version())
            case "devices":
                return HttpReply(200, service.list_devices(_find_space(service, query)))
            case "sessions":
                sessions = [_describe_session(service, one) for one in service.sessions.values()]
                return _answer({"session_count": len(sessions), "sessions": sessions})
            case "settings":
                return _answer({})
    if len(words) in (3, 4) and words[2] == "config":
        return _route_config(service, method, words, query, body)
    if words and len(words) < 3 and (name := _OLD.get(words[-1], words[-1])) in _CONFIG:
        service.tell("http-route-deprecated", "system", "warning", {"route": "/".join(words)[:100]})
        return _refuse(404, f"'{words[-1]}' has another route now: /{TOOL}/0/config/{name}")
    return _refuse(404, "no such route; there are /version, /devices, /sessions, /settings and /TYPE/ID/config/NAME")


def _route_config(
    service: Service, method: str, words: list[str], query: Mapping[str, list[str]], body: bytes
) -> HttpReply:
    kind = find_kind(service.identity, words[0], words[1], one=method == "GET")
    name = words[3] if len(words) == 4 else ""
    if name and (name not in _CONFIG or kind != TOOL):
        return _refuse(404, f"{kind} has no config '{name}'; {TOOL} has {', '.join(_CONFIG)}")
    session = _find_session(service, query)
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
        return _refuse(400, f"the body is no JSON: {str(cause)[:200]}")
    if kind != TOOL:
        return _answer({"type": kind, "handedness": "right"})
    space = service.space if session is None else session.space
    if name:
        return _answer(service.settings.as_command(name, service.identity, space))
    return _answer(service.settings.as_json(service.identity, space))


def _restore(service: Service, session: Session | None, name: str) -> None:
    """What `name` is without anybody's word."""
    if name in _FIXED:
        return
    first = default_space(service.served.device)
    name = "preset" if name == "mount" else name
    service.configure(session, {name: Settings().as_command(name, service.identity, first)})


def _find_session(service: Service, query: Mapping[str, list[str]]) -> Session | None:
    """The session that ?session= means; None, without: all of now, and all that connect from now on."""
    given = query.get("session", [])
    return find_session(list(service.sessions.values()), given[0]) if given else None


def _find_space(service: Service, query: Mapping[str, list[str]]) -> Space:
    session = _find_session(service, query)
    return service.space if session is None else session.space


def _describe_version() -> dict[str, Any]:
    return {
        "project_name": "haptorb",
        "project_version": f"{_PROTOCOL}.0",
        "git_tag": _PROTOCOL,
        "git_describe": f"{_PROTOCOL}-haptorb-{__version__}",
        "git_branch": "",
        "git_hash": "",
        "build_time": "",
    }


def _describe_session(service: Service, session: Session) -> dict[str, Any]:
    return {
        "session_id": session.number,
        "profile": {"name": session.name},
        "rate_hz": round(session.rate, 1),
        "holds": service.served.holder == session.number,
    }


def _answer(data: Mapping[str, Any]) -> HttpReply:
    return HttpReply(200, {"ok": True, "data": dict(data)})


def _refuse(status: int, error: str) -> HttpReply:
    return HttpReply(status, {"ok": False, "error": error})
