"""Address of a database: a file, or a URL, whose password must appear in no message and no list of processes.

Without SQLAlchemy, which only studies and design searches install: every command refuses an address with a password.
"""

from __future__ import annotations

import re
from pathlib import Path
from urllib.parse import unquote_plus

__all__ = ["has_password", "mask_password", "path_of"]

_SECRETS = ("password", "sslpassword")  #: query parameters of an address that are secret

#: URL of a SQLite file: the file, and parameters of the driver, which haptorb sets itself
_SQLITE = re.compile(r"sqlite(?:\+\w+)?:///([^?]*)(?:\?.*)?", re.DOTALL)
#: "scheme://user:password@" up to the last @ before the host; what SQLAlchemy takes for the password, or more
_USER_PASSWORD = re.compile(r"(?<=://)([^:/]*:)[^@]*@(?:[^/?@]*@)*")


def path_of(place: str | Path) -> Path | None:
    """Return the file of a SQLite database, None for a server's.

    >>> path_of("study.db?").as_posix(), path_of("sqlite+pysqlite:///study.db?timeout=3").as_posix()
    ('study.db?', 'study.db')
    >>> path_of("postgresql://host/name")
    """
    text = str(place)
    if "://" not in text:
        return Path(text)
    found = _SQLITE.fullmatch(text)
    return None if found is None else Path(found[1])


def has_password(place: str | Path) -> bool:
    """Whether the address `place` holds a password.

    >>> has_password("postgresql://me:secret@host/name"), has_password("postgresql://me@host/name")
    (True, False)
    """
    text = str(place)
    _, _, query = text.partition("?")
    return "://" in text and (_USER_PASSWORD.search(text) is not None or any(map(_is_secret, query.split("&"))))


def mask_password(place: str | Path) -> str:
    """Return `place` without the password that a URL may contain.

    >>> mask_password("postgresql://me:secret@host/name"), mask_password("postgresql://host/name?password=secret")
    ('postgresql://me:***@host/name', 'postgresql://host/name?password=***')
    """
    text = str(place)
    if "://" not in text:
        return text
    base, mark, query = _USER_PASSWORD.sub(r"\1***@", text, count=1).partition("?")
    shown = (f"{one.partition('=')[0]}=***" if _is_secret(one) else one for one in query.split("&"))
    return f"{base}{mark}{'&'.join(shown)}"


def _is_secret(parameter: str) -> bool:
    """Whether `parameter`, "name=value" of a query, holds a password."""
    name, _, value = parameter.partition("=")
    return value != "" and unquote_plus(name) in _SECRETS
