"""Options `--world` and `--set`: a world of the catalogue, or the user's own in a file, and values with units."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from haptorb.errors import InputError, quote
from haptorb.terminal import announce_wait

if TYPE_CHECKING:
    from haptorb.devices.base import Device
    from haptorb.worlds import World
    from haptorb.worlds.base import Parameter
    from haptorb.worlds.scene import SceneFile
    from haptorb.worlds.user_world import WorldFile

__all__ = ["choose_scene_option", "choose_world_option", "parse_settings", "refuse_scene_options"]


def choose_world_option(name: str, settings: list[str], device: Device) -> World | WorldFile:
    """Return the world `name` with `settings`; for FILE.py:NAME the file, whose world was called once for `device`.

    Raises UnknownName and InputError for invalid names, values and code.
    """
    from dataclasses import replace

    from haptorb.cli.own_code import start_world_file
    from haptorb.file_kind import FileKind, find_kind
    from haptorb.worlds import CATALOGUE, find_world
    from haptorb.worlds.base import parameters
    from haptorb.worlds.user_world import is_world_file, parse_world_file, try_world

    if not is_world_file(name):
        if name not in CATALOGUE and (other := find_kind(name)) is not None:
            raise InputError(FileKind.WORLD.explain_found(name, other))
        kind = find_world(name)
        return kind().replace(**parse_settings(settings, parameters(kind)))
    file = parse_world_file(name)
    world = start_world_file(file)
    values = parse_settings(settings, parameters(type(world)))
    with announce_wait(f"World '{world.name}' of {file.path} has not returned from its first call"):
        try_world(world.replace(**values), device)
    return replace(file, values=values)


def choose_scene_option(
    scene: str | None, body: str | None, world: str | None, settings: list[str], device: Device,
    assets: Path | None = None,
) -> SceneFile:  # fmt: skip
    """Return the `scene` whose `body` is held, with `settings`; it was compiled and stepped once for `device`.

    Raises UnknownName and InputError for invalid options, and for a `world` in addition.
    """
    from dataclasses import replace

    from haptorb.worlds.base import parameters
    from haptorb.worlds.scene import parse_scene_file
    from haptorb.worlds.user_world import note_start, try_world

    if scene is None:
        raise InputError("--body names the body of a scene: give --scene as well, such as --scene peg")
    if world is not None:
        raise InputError("--scene and --world exclude each other; in Python worlds add: Scene('peg') + Fluid()")
    file = parse_scene_file(scene, body or "", assets=assets)
    with announce_wait(f"Scene {file.path} has not finished loading"):
        loaded = file.load()
    note_start(loaded)
    values = parse_settings(settings, parameters(type(loaded)))
    try_world(loaded.replace(**values), device)
    return replace(file, values=values)


def refuse_scene_options(world: str | None, grip: str, latency: float | None) -> None:
    """Raise InputError for --grip or --latency without a scene; a `world` from a file may be one."""
    from haptorb.worlds.user_world import is_world_file

    if (grip != "light" or latency is not None) and not is_world_file(world or ""):
        raise InputError("--grip and --latency are for a scene: give --scene as well, such as --scene boxes")


def parse_settings(settings: list[str], known: dict[str, Parameter]) -> dict[str, float | tuple[float, ...]]:
    """Parse NAME=VALUE, with or without a unit, and NAME=X,Y,Z to values by name; unknown names are accepted."""
    values: dict[str, float | tuple[float, ...]] = {}
    for setting in settings:
        name, equals, text = setting.partition("=")
        name = name.strip()
        unit = known[name].unit if name in known else "1"
        numbers = tuple(_number(part, unit, setting) for part in text.split(","))
        if not equals:
            raise _mistake(setting)
        values[name] = numbers[0] if len(numbers) == 1 else numbers
    return values


def _number(text: str, unit: str, setting: str) -> float:
    """Parse a number in `unit`, which is also the default."""
    from haptorb.devices.quantity import si

    try:
        return float(text)
    except ValueError:
        pass
    if not text.strip()[:1].isdigit() and text.strip()[:1] not in ("+", "-", "."):
        raise _mistake(setting)
    plain = unit in ("", "1")
    try:
        return si(text, "" if plain else unit, "a number without a unit" if plain else f"a value in {unit}")
    except ValueError as cause:
        raise InputError(f"--set {quote(setting)}: {cause}") from cause


def _mistake(setting: str) -> InputError:
    return InputError(f'--set must be NAME=VALUE, NAME="VALUE UNIT" or NAME=X,Y,Z, with numbers; got {quote(setting)}')
