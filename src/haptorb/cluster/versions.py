"""Versions on the computers of a cluster: with different ones results could differ, or jobs could not be read.

A scheduler passes jobs without unpacking them, so only its Dask and Python must be the same as here. A worker computes,
so haptorb and its numerical libraries must be the same, too.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from haptorb.errors import InputError
from haptorb.version import __version__

__all__ = ["check_versions", "list_versions"]

_DASK = ("distributed", "dask", "cloudpickle")
_NUMBERS = ("numpy", "scipy", "numba")


def check_versions(client: Any, address: str) -> None:
    """InputError, with both versions, unless scheduler and workers of the Dask `client` have those of this computer."""
    found = client.get_versions(packages=_NUMBERS)
    here = _list_packages(found["client"])
    scheduler = _list_packages(found["scheduler"])
    _refuse(f"the Dask scheduler at '{address}' has", scheduler, here, ("Python", *_DASK[:2]))
    whose = f"the Dask workers at '{address}' have"
    for worker in found["workers"].values():
        _refuse(whose, _list_packages(worker), here, ("Python", *_DASK, *_NUMBERS))
    for worker in client.run(_make_look(), on_error="return").values():  # an exception: a worker without haptorb
        versions = {"haptorb": worker} if isinstance(worker, str) else {}
        _refuse(whose, versions, {"haptorb": __version__}, ("haptorb",))


def list_versions() -> dict[str, str]:
    """Package → version on this computer, of all that determines results."""
    from importlib.metadata import version

    return {"haptorb": __version__, **{name: version(name) for name in _NUMBERS}}


def _refuse(whose: str, theirs: Mapping[str, str], here: Mapping[str, str], names: Iterable[str]) -> None:
    for name in names:
        if theirs.get(name) != here.get(name):
            raise InputError(
                f"{whose} {name} {theirs.get(name) or '(missing)'}, this computer has {here.get(name)}: install the "
                "same version on all"
            )


def _list_packages(computer: Mapping[str, Any]) -> dict[str, str]:
    """Package → version, as Dask reports for one computer; Python without the last number."""
    packages = {name: str(value) for name, value in computer["packages"].items() if value is not None}
    packages["Python"] = ".".join(packages.pop("python", "").split(".")[:2])
    return packages


def _make_look() -> Any:
    """A function that is sent with its code: a worker may not have this module."""

    def look() -> str:
        from haptorb.version import __version__ as here

        return str(here)

    return look
