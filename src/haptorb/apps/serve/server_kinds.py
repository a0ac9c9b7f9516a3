"""The kinds of servers that `--serve` knows; adding one is a module and a line here."""

from __future__ import annotations

from importlib import import_module
from typing import Any, Literal, Protocol, cast

from haptorb.apps.serve.preparation import ServerPreparation
from haptorb.apps.serve.served_device import ServedDevice
from haptorb.errors import DriverError
from haptorb.numerics.record import record

__all__ = ["KINDS", "KindModule", "ServerKind", "load_kind"]


@record
class ServerKind:
    """What is known of a kind before its module is loaded.

    form     how it is written behind --serve
    module   that has its `prepare` and `serve`, see `KindModule`
    package  that must be installed for it; empty: none
    world    what becomes of the world: "alone": without --world, the clients' force is all that is felt; "added": the
             clients' force is added to the current world; "unchanged": its clients command no force
    """

    form: str
    module: str
    package: str
    world: Literal["alone", "added", "unchanged"]


class KindModule(Protocol):
    """The two functions that a kind's module has."""

    def prepare(self, where: str) -> ServerPreparation:
        """In the program that starts the servo: understand `where`, what stands behind the colon of --serve, and open
        its ports. InputError says what was expected."""

    def serve(self, spec: dict[str, Any], descriptors: list[int], served: ServedDevice) -> None:
        """In the server's own process: serve with the `spec` and the open `descriptors` of the preparation, until
        `served.over`."""


#: name before the colon of --serve → kind
KINDS: dict[str, ServerKind] = {
    "haply": ServerKind("haply[:HOST][:PORT[:EVENTS]]", "haptorb.apps.serve.haply.haply_server", "", "alone"),
    "osc": ServerKind("osc[:[HOST:]PORT]", "haptorb.apps.serve.osc.osc_server", "pythonosc", "added"),
    "lsl": ServerKind("lsl", "haptorb.apps.serve.lsl.lsl_server", "pylsl", "unchanged"),
    "foxglove": ServerKind("foxglove[:PORT]", "haptorb.apps.serve.foxglove.foxglove_server", "foxglove", "unchanged"),
}


def load_kind(name: str) -> KindModule:
    """The module of the kind `name`. Raises DriverError if the package that it needs is not installed."""
    kind = KINDS[name]
    try:
        if kind.package:
            import_module(kind.package)
    except (ImportError, OSError, RuntimeError) as cause:  # pylsl says RuntimeError when its library is missing
        raise DriverError(
            f"--serve {name} needs a package that is not installed ({cause}): pip install 'haptorb[serve]'"
        ) from cause
    return cast("KindModule", import_module(kind.module))
