"""From the options `--serve KIND[:...]` to servers that are prepared, and to the world that is felt with them."""

from __future__ import annotations

from collections.abc import Sequence

from haptorb.apps.serve.server_kinds import KINDS
from haptorb.errors import InputError, UnknownName
from haptorb.numerics.record import record
from haptorb.worlds import Remote
from haptorb.worlds.own.file_with_remote import FileWithRemote
from haptorb.worlds.own.world_file import WorldFile
from haptorb.worlds.scene.scene_file import SceneFile
from haptorb.worlds.world import World

__all__ = ["ServerChoice", "add_client_force", "check_servers", "is_client_force_alone"]


@record
class ServerChoice:
    """One `--serve`: the `kind`, and what stands behind its colon."""

    kind: str
    where: str


def check_servers(texts: Sequence[str]) -> tuple[ServerChoice, ...]:
    """What the options `texts` ask for; nothing is opened.

    Raises UnknownName for a kind that there is not, InputError for two of one kind.

    >>> check_servers(["haply:10001:10020"])
    (ServerChoice(kind='haply', where='10001:10020'),)
    """
    found: dict[str, ServerChoice] = {}
    for text in texts:
        kind, _, where = text.partition(":")
        if kind not in KINDS:
            raise UnknownName("server", kind, [one.form for one in KINDS.values()])
        if kind in found:
            raise InputError(
                f"--serve {kind} was given twice: a run has one server of a kind, for any number of clients"
            )
        found[kind] = ServerChoice(kind, where)
    return tuple(found.values())


def is_client_force_alone(choices: Sequence[ServerChoice]) -> bool:
    """Whether, without --world, the clients' force is all that is felt."""
    return any(KINDS[choice.kind].world == "alone" for choice in choices)


def add_client_force(
    world: World | WorldFile | SceneFile, choices: Sequence[ServerChoice]
) -> World | FileWithRemote | WorldFile | SceneFile:
    """`world` with the force of the clients of these servers, if one of them has clients that command forces; a file
    keeps it whenever it is loaded again."""
    if isinstance(world, Remote) or all(KINDS[choice.kind].world == "unchanged" for choice in choices):
        return world
    return FileWithRemote(world) if isinstance(world, WorldFile | SceneFile) else world + Remote()
